//! Tests of the channels between tasks and of the input filter, as the firmware uses them.
#![no_std]
#![no_main]
#![allow(missing_docs, reason = "code that defmt-test generates")]

use oxmill_on_target as _;

#[defmt_test::tests]
mod suite {
    use oxmill_controller::machine::filter::Filter;
    use oxmill_controller::messages::{
        AxisSteps, LINE_MESSAGES, LINES_DEPTH, LineByte, LineBytes, SEGMENTS_DEPTH, Segment, StepEvent, ToStep,
    };
    use oxmill_controller::{LineReader, LineSender, Stepper};
    use rtic_sync::channel::Channel;

    #[test]
    fn a_message_to_the_step_task_fits_16_bytes() {
        defmt::assert!(size_of::<ToStep>() <= 16, "{} bytes", size_of::<ToStep>());
    }

    #[test]
    fn the_line_queue_keeps_order_and_refuses_when_full() {
        let mut channel: Channel<LineBytes, LINE_MESSAGES> = Channel::new();
        let (mut send, mut receive) = channel.split();
        let (mut sender, mut reader) = (LineSender::default(), LineReader::default());
        for round in 0..3_u8 {
            let mut inside = 0_u16;
            let byte = |place: u16| LineByte { byte: place as u8, epoch: round.into(), damaged: false };
            // Bytes are queued one at a time, as from a UART.
            while sender.push(byte(inside), |message| send.try_send(message).is_ok()) {
                sender.flush(send.is_empty(), |message| send.try_send(message).is_ok());
                inside += 1;
            }
            defmt::assert!(send.is_full() && usize::from(inside) >= LINES_DEPTH, "{} bytes", inside);
            for place in 0..inside {
                let got = reader.next(|| receive.try_recv().ok());
                defmt::assert!(got == Some(byte(place)));
                if receive.is_empty() {
                    sender.flush(true, |message| send.try_send(message).is_ok());
                }
            }
            defmt::assert!(reader.next(|| receive.try_recv().ok()).is_none());
        }
    }

    /// After a stop, the stepper ignores all queued messages, sent before or after the stop, until `Resume` answers the
    /// most recent stop.
    #[test]
    fn nothing_queued_survives_a_stop() {
        let mut channel: Channel<ToStep, SEGMENTS_DEPTH> = Channel::new();
        let (mut send, mut receive) = channel.split();
        let segment =
            Segment { interval: 100 << 12, ramp: 0, ticks: 5, power: 9, level: 0, flags: Segment::FLAG_NEW_BLOCK };
        for _ in 0..8 {
            let block = ToStep::Block { steps_by_axis: [10, 5, 0].map(AxisSteps::on_steps), directions: 0 };
            defmt::assert!(send.try_send(block).is_ok());
            defmt::assert!(send.try_send(ToStep::Segment(segment)).is_ok());
        }
        let mut stepper: Stepper<3> = Stepper::new();
        let load = |stepper: &mut Stepper<3>,
                    receive: &mut rtic_sync::channel::Receiver<'_, ToStep, SEGMENTS_DEPTH>| {
            while stepper.has_room()
                && let Ok(message) = receive.try_recv()
            {
                stepper.load(message);
            }
        };
        load(&mut stepper, &mut receive);
        for _ in 0..3 {
            stepper.tick();
        }
        let StepEvent::Stopped { stops, moving, position } = stepper.stop([0; 3]) else { defmt::panic!("no stop") };
        defmt::assert!(moving);
        defmt::assert_eq!(position.0, [2, 1, 0]);
        // After a second stop, the answer to the first stop must not resume motion.
        stepper.stop([0; 3]);
        defmt::assert!(send.try_send(ToStep::Resume { stops }).is_ok());
        load(&mut stepper, &mut receive);
        defmt::assert!(stepper.is_idle());
        defmt::assert_eq!(stepper.tick().interval, 0);
        defmt::assert!(send.try_send(ToStep::Segment(segment)).is_ok());
        load(&mut stepper, &mut receive);
        defmt::assert!(stepper.is_idle());
        let resume = ToStep::Resume { stops: stops.wrapping_add(1) };
        defmt::assert!(send.try_send(resume).is_ok());
        defmt::assert!(
            send.try_send(ToStep::Block { steps_by_axis: [10, 5, 0].map(AxisSteps::on_steps), directions: 1 }).is_ok()
        );
        defmt::assert!(send.try_send(ToStep::Segment(segment)).is_ok());
        load(&mut stepper, &mut receive);
        defmt::assert!(!stepper.is_idle());
        stepper.tick();
        defmt::assert_eq!(stepper.tick().steps, 1);
    }

    #[test]
    fn an_input_changes_after_eight_equal_samples() {
        let mut filter = Filter::new();
        for _ in 0..7 {
            defmt::assert_eq!(filter.sample(0b101), 0);
        }
        defmt::assert_eq!(filter.sample(0b001), 0b001);
        // The eighth sample of bit 2 was low, so the count of bit 2 starts again.
        for _ in 0..7 {
            defmt::assert_eq!(filter.sample(0b101), 0b001);
        }
        defmt::assert_eq!(filter.sample(0b101), 0b101);
        for _ in 0..7 {
            defmt::assert_eq!(filter.sample(0), 0b101);
        }
        defmt::assert_eq!(filter.sample(0), 0);
    }
}
