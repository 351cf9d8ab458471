//! The USB port of an STM32F4 (OTG_FS as a device): a serial port on the host, CDC-ACM, in packets of 64 bytes. It
//! holds the host back while there is no room, and notices when a host opens, closes or unplugs the port.
//!
//! ```text
//!  host ──OUT packet──▶ receive FIFO ──▶ packet ──receive──▶ serial task      next packet only when there is room for it
//!  host ◀──IN packet─── transmit FIFO ◀── outgoing ◀──send── serial task
//! ```
//! Flow control (back-pressure): the hardware answers NAK from the end of one packet until software enables the endpoint again. The driver
//! would do that by itself, and a packet that is not fetched would then sit in the FIFO, call the interrupt for ever and
//! keep the control endpoint behind it from being heard. So the entry that ends a packet is taken out of the FIFO here, and
//! the endpoint is enabled when a whole packet fits: what is in the FIFO can always be fetched at once, and DTR, suspend
//! and reset are heard while the host is told to wait.
//!
//! While flash is written the processor is stalled; the FIFO keeps one packet, and the host is told to wait.

use cortex_m::singleton;
use stm32f4xx_hal::{
    gpio::alt::otg_fs as alt,
    otg_fs::{USB, UsbBus, UsbBusType},
    pac,
    rcc::Clocks,
};
use usb_device::class::{ControlIn, ControlOut, UsbClass};
use usb_device::control::{Recipient, Request, RequestType};
use usb_device::descriptor::DescriptorWriter;
use usb_device::endpoint::EndpointAddress;
use usb_device::prelude::*;
use usbd_serial::{CdcAcmClass, USB_CLASS_CDC};

use super::clock_ticks;
use crate::calls::is_stop;
use crate::usb_host::{LATE_BYTES_US, UsbHost};
use crate::{Incoming, Port};

/// Largest packet of a bulk endpoint at full speed (USB 2.0, 5.8.3).
const PACKET: usize = 64;
/// Bytes sent at a time. A transfer ends with a packet that is not full, so every packet is a transfer of its own.
const SENT: usize = PACKET - 1;
/// Words of the driver's receive buffers: 64 bytes each for the control endpoint and the data endpoint.
const BUFFERS: usize = 2 * PACKET / 4;

/// The test id of pid.codes: for development only, no device may be sold with it.
const ID: UsbVidPid = UsbVidPid(0x1209, 0x0001);

/// OTG_FS registers as offsets from its base (RM0383, 22.16.2 to 22.16.4).
const GINTSTS: usize = 0x014;
const GINTMSK: usize = 0x018;
const GRXSTSR: usize = 0x01C;
const GRXSTSP: usize = 0x020;
/// The bus is suspended.
const DSTS: usize = 0x808;
const SUSPENDED: u32 = 1;
/// Which endpoints call; those to the host are its lowest bits.
const DAINTMSK: usize = 0x81C;
const DIEPCTL: usize = 0x900;
const DOEPCTL: usize = 0xB00;
/// DOEPTSIZ, behind DOEPCTL: one packet of [`PACKET`] bytes.
const DOEPTSIZ: usize = 0xB10;
const ONE_PACKET: u32 = 1 << 19 | PACKET as u32;
/// Bytes from the register of one endpoint to that of the next.
const NEXT_ENDPOINT: usize = 0x20;
/// GINTSTS and GINTMSK: the receive FIFO is not empty; and all that the driver attends to, with suspend, reset, enumeration,
/// IN endpoints and wake-up.
const RXFLVL: u32 = 1 << 4;
const EVENTS: u32 = RXFLVL | 1 << 11 | USBRST | 1 << 13 | 1 << 18 | 1 << 31;
const USBRST: u32 = 1 << 12;
/// GRXSTSR and GRXSTSP: endpoint, and what the entry is.
const EPNUM: u32 = 0xF;
const PKTSTS_SHIFT: u32 = 17;
const PKTSTS: u32 = 0xF;
const OUT_DATA: u32 = 2;
const OUT_COMPLETED: u32 = 3;
/// DOEPCTL and DIEPCTL: enabled, no more NAK, and both.
const ENABLED: u32 = 1 << 31;
const CNAK: u32 = 1 << 26;
const ENABLED_AGAIN: u32 = CNAK | ENABLED;
/// DIEPCTL: NAK, disabled; and behind it DIEPINT, where either is told once it is in force.
const SNAK: u32 = 1 << 27;
const DISABLED: u32 = 1 << 30;
const DIEPINT: usize = 0x08;
const NAK_IN_FORCE: u32 = 1 << 6;
const IS_DISABLED: u32 = 1 << 1;
/// GRSTCTL: empties the transmit FIFO of this number.
const GRSTCTL: usize = 0x010;
const TXFFLSH: u32 = 1 << 5;
const TXFNUM_SHIFT: u32 = 6;
/// How long a flag of an endpoint is waited for: twice the time of a packet of 64 bytes on the bus (USB 2.0, 5.8.3).
const FLAG_TICKS: u32 = 100 * crate::CLOCK_TICKS_PER_US;
/// DOEPCTL and DIEPCTL: the next packet is DATA0.
const SD0PID: u32 = 1 << 28;
/// Number of the interface of the data endpoints: that of the class behind its first, of control.
const DATA_INTERFACE: u16 = 1;

/// Where the part's number of 96 bits lies (RM0383, 24.1; RM0368, 24.1).
const UNIQUE_ID: usize = 0x1FFF_7A10;
/// Hexadecimal digits of it.
const SERIAL_NUMBER: usize = 24;

fn read(offset: usize) -> u32 {
    let address = (pac::OTG_FS_GLOBAL::ptr() as usize + offset) as *const u32;
    // SAFETY: unsafe because a register is read by its address past the driver that owns it; safe because only the offsets
    // above are used, and only by the serial task, in between the driver's calls. GRXSTSP takes an entry out of the FIFO,
    // which the driver does not miss: it keeps no account of them.
    unsafe { address.read_volatile() }
}

fn write(offset: usize, word: u32) {
    let address = (pac::OTG_FS_GLOBAL::ptr() as usize + offset) as *mut u32;
    // SAFETY: unsafe because a register is written by its address past the driver that owns it; safe because only GINTMSK,
    // DAINTMSK, GRSTCTL and the registers of the data endpoints are written, by the serial task, in between the driver's calls,
    // and what the driver finds there afterwards is what it would find behind a packet or a reset of the bus.
    unsafe { address.write_volatile(word) }
}

/// Waits until bits have this value, for [`FLAG_TICKS`] at most. Whether they have.
fn await_bits(offset: usize, bits: u32, value: u32) -> bool {
    let began = clock_ticks();
    while read(offset) & bits != value {
        if clock_ticks().wrapping_sub(began) > FLAG_TICKS {
            return false;
        }
    }
    true
}

/// The next packet of an endpoint is DATA0. Whether it is enabled stays as it is.
fn begin_with_data0(base: usize, endpoint: EndpointAddress) {
    let control = base + endpoint.index() * NEXT_ENDPOINT;
    write(control, read(control) & !ENABLED | SD0PID);
}

/// How long after its end a host's bytes may still come.
const LATE_BYTES_TICKS: u32 = LATE_BYTES_US * crate::CLOCK_TICKS_PER_US;

/// The serial port as the driver sees it. Besides, it hears which of the data endpoints have to begin with DATA0, as the host
/// does after a request (USB 2.0, 9.1.1.5 and 9.4.5). The driver leaves their toggles alone: the next packet would be taken for
/// one that was sent again, and be lost.
struct SerialClass {
    port: CdcAcmClass<'static, UsbBusType>,
    begin_out: bool,
    begin_in: bool,
}

// A second class beside the first would do; with one alone the compiler knows what the driver calls, which saves a kilobyte.
impl UsbClass<UsbBusType> for SerialClass {
    fn get_configuration_descriptors(&self, writer: &mut DescriptorWriter<'_>) -> usb_device::Result<()> {
        self.port.get_configuration_descriptors(writer)
    }

    fn reset(&mut self) {
        self.port.reset();
    }

    fn control_in(&mut self, transfer: ControlIn<'_, '_, '_, UsbBusType>) {
        self.port.control_in(transfer);
    }

    fn control_out(&mut self, transfer: ControlOut<'_, '_, '_, UsbBusType>) {
        let Request { request_type, recipient, request, value, index, .. } = *transfer.request();
        if request_type == RequestType::Standard {
            // Others are refused, and change nothing.
            let both = (recipient, request) == (Recipient::Device, Request::SET_CONFIGURATION) && value <= 1
                || (recipient, request, index) == (Recipient::Interface, Request::SET_INTERFACE, DATA_INTERFACE)
                    && value == 0;
            let one = (recipient, request, value)
                == (Recipient::Endpoint, Request::CLEAR_FEATURE, Request::FEATURE_ENDPOINT_HALT);
            self.begin_out |= both || one && index == u16::from(u8::from(self.port.read_ep().address()));
            self.begin_in |= both || one && index == u16::from(u8::from(self.port.write_ep().address()));
        }
        self.port.control_out(transfer);
    }
}

/// The receiving half: what has been fetched of the last packet.
struct Received {
    packet: [u8; PACKET],
    length: usize,
    next: usize,
    /// The packet before has ended, and the endpoint waits to be enabled.
    ended: bool,
    /// The driver has seen events since it was last found without a packet. Only then it may have one; to ask takes 4 us,
    /// and the serial task asks with each byte of the UART.
    may_wait: bool,
}

impl Received {
    /// What has not been taken yet.
    fn left(&self) -> &[u8] {
        self.packet.get(self.next..self.length).unwrap_or_default()
    }
}

/// The port.
pub struct UsbPort {
    device: UsbDevice<'static, UsbBusType>,
    class: SerialClass,
    received: Received,
    outgoing: heapless::Vec<u8, SENT>,
    host: UsbHost,
    /// The bus is being reset: until its end the driver takes the device for set up, but what is written to an endpoint
    /// meanwhile is never sent and keeps it busy for ever.
    resetting: bool,
    /// The interrupt of the receive FIFO is masked.
    masked: bool,
}

impl UsbPort {
    /// Switches OTG_FS on; 48 MHz must be there. To be called once.
    pub fn new(
        registers: (pac::OTG_FS_GLOBAL, pac::OTG_FS_DEVICE, pac::OTG_FS_PWRCLK),
        pins: (impl Into<alt::Dm>, impl Into<alt::Dp>),
        clocks: &Clocks,
    ) -> UsbPort {
        // OTG_FS works at 48 MHz within 0.25 % (USB 2.0, 7.1.11); another clock would never come to life.
        assert!(clocks.pll48clk().is_some_and(|clock| clock.raw() == 48_000_000), "no 48 MHz for USB");
        let usb = USB::new(registers, pins, clocks);
        let (Some(buffers), Some(number)) =
            (singleton!(: [u32; BUFFERS] = [0; BUFFERS]), singleton!(: [u8; SERIAL_NUMBER] = serial_number()))
        else {
            unreachable!("set up twice")
        };
        let Some(bus) = singleton!(: usb_device::bus::UsbBusAllocator<UsbBusType> = UsbBus::new(usb, buffers)) else {
            unreachable!("set up twice")
        };
        let class = CdcAcmClass::new(bus, PACKET as u16);
        let strings = StringDescriptors::default()
            .manufacturer("Oxmill")
            .product(crate::PROFILE.name)
            .serial_number(core::str::from_utf8(number).unwrap_or_default());
        let device = UsbDeviceBuilder::new(bus, ID).device_class(USB_CLASS_CDC).strings(&[strings]);
        let device = device.and_then(|device| device.max_packet_size_0(PACKET as u8));
        let Ok(device) = device.map(UsbDeviceBuilder::build) else { unreachable!("both are what the builder takes") };
        let received = Received { packet: [0; PACKET], length: 0, next: 0, ended: false, may_wait: false };
        UsbPort {
            device,
            class: SerialClass { port: class, begin_out: false, begin_in: false },
            received,
            outgoing: heapless::Vec::new(),
            host: UsbHost::new(),
            resetting: false,
            masked: false,
        }
    }

    /// What the receive FIFO begins with, if it is for the data endpoint.
    fn entry(&self) -> Option<u32> {
        let entry = (read(GINTSTS) & RXFLVL != 0).then(|| read(GRXSTSR))?;
        let data = (entry & EPNUM) as usize == self.class.port.read_ep().address().index();
        data.then_some(entry >> PKTSTS_SHIFT & PKTSTS)
    }

    /// Takes the end of a data packet out of the FIFO, before the driver sees it and enables the endpoint.
    fn hold_endpoint(&mut self) {
        if self.entry() == Some(OUT_COMPLETED) {
            read(GRXSTSP);
            self.received.ended = true;
        }
    }

    /// Lets the host send the next packet, and no other behind it: its end is that of a transfer of one packet (RM0383, 22.17.6,
    /// "Generic non-isochronous OUT data transfers"). The driver leaves the size open when it enables the endpoint for the first time.
    fn enable_endpoint(&mut self) {
        let at = self.class.port.read_ep().address().index() * NEXT_ENDPOINT;
        let control = DOEPCTL + at;
        let before = read(control);
        // The driver may have enabled it: then its size is not to be touched.
        if before & ENABLED == 0 {
            write(DOEPTSIZ + at, ONE_PACKET);
        }
        write(control, before | ENABLED_AGAIN);
        self.received.ended = false;
    }

    /// Has the data endpoints begin with DATA0 where the host does.
    fn begin_toggles(&mut self) {
        let SerialClass { port, begin_out, begin_in } = &mut self.class;
        if core::mem::take(begin_out) {
            begin_with_data0(DOEPCTL, port.read_ep().address());
        }
        if core::mem::take(begin_in) {
            begin_with_data0(DIEPCTL, port.write_ep().address());
        }
    }

    /// A packet can end between two looks at the FIFO, and the driver then enables the endpoint; twice in a row, and a
    /// packet waits that has no place. Its interrupt must not call for ever: it is masked until there is room.
    fn mask(&mut self, masked: bool) {
        if masked != self.masked {
            self.masked = masked;
            let mask = read(GINTMSK);
            write(GINTMSK, if masked { mask & !RXFLVL } else { mask | RXFLVL });
        }
    }

    /// Whether there is a host that has set the device up. The driver takes also what came before the bus went idle for a sign of
    /// one, if it reads that afterwards.
    fn is_configured(&self) -> bool {
        self.device.state() == UsbDeviceState::Configured && !self.resetting && read(DSTS) & SUSPENDED == 0
    }

    /// The host has gone, and what it has sent goes with it: here, and in the driver's buffer.
    fn forget_received(&mut self) {
        let _ = self.class.port.read_packet(&mut self.received.packet);
        self.received.length = 0;
        self.received.next = 0;
    }

    /// The host has gone, and what it was to be sent goes with it: a packet, too, that it has not fetched (RM0383, 22.17.6,
    /// "IN endpoint disable").
    fn forget_sent(&mut self) {
        self.outgoing.clear();
        let endpoint = self.class.port.write_ep().address().index();
        let control = DIEPCTL + endpoint * NEXT_ENDPOINT;
        let is_enabled = || read(control) & ENABLED != 0;
        if !is_enabled() {
            return;
        }
        // What is told of an earlier time does not count.
        write(control + DIEPINT, NAK_IN_FORCE | IS_DISABLED);
        write(control, read(control) & !ENABLED | SNAK);
        let is_refused = await_bits(control + DIEPINT, NAK_IN_FORCE, NAK_IN_FORCE);
        if !is_enabled() {
            // It has just been fetched.
            return;
        }
        if is_refused {
            write(control, read(control) & !ENABLED | DISABLED);
        }
        if is_refused && await_bits(control + DIEPINT, IS_DISABLED, IS_DISABLED) {
            write(GRSTCTL, (endpoint as u32) << TXFNUM_SHIFT | TXFFLSH);
            await_bits(GRSTCTL, TXFFLSH, 0);
        } else {
            // It stays, and goes to the next host: better than an endpoint that refuses for ever.
            write(control, read(control) & !ENABLED | CNAK);
        }
    }

    fn flush(&mut self) {
        if !self.outgoing.is_empty() && self.class.port.write_packet(&self.outgoing).is_ok() {
            self.outgoing.clear();
        }
    }
}

impl Port for UsbPort {
    const WAITS: bool = true;

    fn poll(&mut self) -> bool {
        self.hold_endpoint();
        // The driver masks interrupts for as long as it looks: not for nothing.
        let events = read(GINTSTS);
        if events & USBRST != 0 {
            self.resetting = true;
            // The driver disables its endpoints without the NAK that has to be in force before.
            self.forget_sent();
        }
        if events & EVENTS != 0 {
            self.device.poll(&mut [&mut self.class]);
            self.begin_toggles();
            self.received.may_wait = true;
            // The end of the packet that the driver has just fetched lies behind it as a rule, and need not call once more.
            self.hold_endpoint();
        }
        if self.device.state() == UsbDeviceState::Default {
            // A reset of the bus has emptied the FIFO and enabled the endpoint. A configuration that is taken back has not.
            self.resetting = false;
            self.received.ended = false;
        }
        let look = self.host.look(self.class.port.dtr(), self.is_configured(), clock_ticks);
        if look.gone {
            self.forget_sent();
            self.forget_received();
        }
        look.there
    }

    fn receive(&mut self) -> Incoming {
        let received = &mut self.received;
        if received.next >= received.length {
            if !received.may_wait {
                return Incoming::Nothing;
            }
            received.next = 0;
            let packet = self.class.port.read_packet(&mut received.packet);
            received.may_wait = packet.is_ok();
            received.length = packet.unwrap_or(0);
            if received.length > 0 {
                let is_known = self.host.is_listening();
                if !self.is_configured() || !self.host.speaks(LATE_BYTES_TICKS, clock_ticks) {
                    self.received.length = 0;
                } else if !is_known {
                    // It is seen to come before its bytes are read: behind them it would cut its own line in two.
                    crate::call_serial();
                    return Incoming::Nothing;
                }
            }
        }
        let Some(byte) = self.received.left().first().copied() else { return Incoming::Nothing };
        self.received.next += 1;
        Incoming::Byte(byte)
    }

    fn fetched(&mut self) -> &[u8] {
        self.received.left()
    }

    fn pass(&mut self, count: usize) {
        self.received.next += count;
    }

    fn is_urgent(&mut self) -> bool {
        self.received.left().iter().any(|byte| is_stop(*byte))
    }

    fn allow(&mut self, room: usize) {
        // Without room nothing is fetched, and there may be a packet here, one with the driver and one in the FIFO.
        self.mask(room == 0 && self.entry() == Some(OUT_DATA));
        let fetched = self.received.next >= self.received.length;
        if self.received.ended && fetched && room >= PACKET && self.is_configured() {
            self.enable_endpoint();
        }
    }

    fn send(&mut self, byte: u8) -> bool {
        if !self.is_configured() || !self.host.is_listening() {
            // No host reads: as on a UART whose cable is not plugged in.
            return true;
        }
        if self.outgoing.is_full() {
            self.flush();
        }
        self.outgoing.push(byte).is_ok()
    }

    fn send_text(&mut self, bytes: &[u8]) -> usize {
        if !self.is_configured() || !self.host.is_listening() {
            return bytes.len();
        }
        if self.outgoing.is_full() {
            self.flush();
        }
        let room = SENT - self.outgoing.len();
        let text = bytes.get(..room).unwrap_or(bytes);
        let _ = self.outgoing.extend_from_slice(text);
        text.len()
    }

    fn call_when_free(&mut self, wanted: bool) {
        if self.is_configured() {
            self.flush();
            // The end of a packet calls if something has had to wait for it.
            let endpoint = 1 << self.class.port.write_ep().address().index();
            let mask = read(DAINTMSK);
            let calls = if self.outgoing.is_empty() && !wanted { mask & !endpoint } else { mask | endpoint };
            if calls != mask {
                write(DAINTMSK, calls);
            }
        }
    }
}

/// The part's own number in hexadecimal digits: it tells two boards on one host apart.
fn serial_number() -> [u8; SERIAL_NUMBER] {
    let mut digits = [0; SERIAL_NUMBER];
    for (word, digits) in digits.chunks_exact_mut(8).enumerate() {
        // SAFETY: unsafe because a raw address is read; safe because it is aligned and lies in read-only system memory.
        let word = unsafe { (UNIQUE_ID as *const u32).add(word).read_volatile() };
        for (place, digit) in digits.iter_mut().rev().enumerate() {
            *digit = b"0123456789ABCDEF".get((word >> (4 * place) & 0xF) as usize).copied().unwrap_or_default();
        }
    }
    digits
}
