//! USB port of an STM32F4 (OTG_FS as a device): a serial port on the host (CDC-ACM) in packets of 64 bytes. It holds
//! the host back while there is no space, and detects when a host opens, closes or unplugs the port.
//!
//! ```text
//!  host ──OUT packet──▶ receive FIFO ──▶ packet ──receive──▶ serial task      next packet only when there is space
//!  host ◀──IN packet─── transmit FIFO ◀── outgoing ◀──send── serial task
//! ```
//! Flow control: after each packet the hardware refuses further packets (NAK) until software enables the endpoint
//! again. The driver would enable the endpoint at once. Then a packet for which there is no space would stay in the
//! FIFO, raise the interrupt forever and block later entries of the control endpoint.
//!
//! Therefore this file removes from the FIFO the entry that ends a packet, before the driver finds this entry. Later
//! this file enables the endpoint itself, but only when there is space for a whole packet. So every packet in the FIFO
//! can be fetched at once. DTR, suspend and reset are processed even while the host has to wait.
//!
//! While flash is written, the processor is stalled. The FIFO then holds one packet, and the hardware answers further
//! packets with NAK.

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
/// Maximum bytes per sent packet: one less than a full packet. A packet that is not full ends a USB transfer, so each
/// sent packet is a complete transfer.
const SENT: usize = PACKET - 1;
/// Words of the driver's receive buffers: 64 bytes each for the control endpoint and the data endpoint.
const BUFFERS: usize = 2 * PACKET / 4;

/// The test id of pid.codes. It is for development only: devices must not be sold with it.
const ID: UsbVidPid = UsbVidPid(0x1209, 0x0001);

/// OTG_FS registers as offsets from its base (RM0383, 22.16.2 to 22.16.4).
const GINTSTS: usize = 0x014;
const GINTMSK: usize = 0x018;
const GRXSTSR: usize = 0x01C;
const GRXSTSP: usize = 0x020;
/// Device status register, and its bit that is set while the bus is suspended.
const DSTS: usize = 0x808;
const SUSPENDED: u32 = 1;
/// Interrupt mask of the endpoints; the lowest bits are those of the IN endpoints (to the host).
const DAINTMSK: usize = 0x81C;
const DIEPCTL: usize = 0x900;
const DOEPCTL: usize = 0xB00;
/// DOEPTSIZ of endpoint 0, and its value for one packet of [`PACKET`] bytes.
const DOEPTSIZ: usize = 0xB10;
const ONE_PACKET: u32 = 1 << 19 | PACKET as u32;
/// Bytes from the register of one endpoint to that of the next.
const NEXT_ENDPOINT: usize = 0x20;
/// Bits of GINTSTS and GINTMSK. `RXFLVL`: the receive FIFO is not empty. `EVENTS`: all events that the driver handles,
/// with suspend, reset, enumeration, IN endpoints and wake-up.
const RXFLVL: u32 = 1 << 4;
const EVENTS: u32 = RXFLVL | 1 << 11 | USBRST | 1 << 13 | 1 << 18 | 1 << 31;
const USBRST: u32 = 1 << 12;
/// GRXSTSR and GRXSTSP: endpoint to which the entry belongs, and kind of the entry.
const EPNUM: u32 = 0xF;
const PKTSTS_SHIFT: u32 = 17;
const PKTSTS: u32 = 0xF;
const OUT_DATA: u32 = 2;
const OUT_COMPLETED: u32 = 3;
/// DOEPCTL and DIEPCTL: enable, clear NAK, and both.
const ENABLED: u32 = 1 << 31;
const CNAK: u32 = 1 << 26;
const ENABLED_AGAIN: u32 = CNAK | ENABLED;
/// DIEPCTL: set NAK (`SNAK`), disable the endpoint (`DISABLED`). The register DIEPINT, at this offset from DIEPCTL,
/// reports when each of the two has taken effect (`NAK_IN_FORCE`, `IS_DISABLED`).
const SNAK: u32 = 1 << 27;
const DISABLED: u32 = 1 << 30;
const DIEPINT: usize = 0x08;
const NAK_IN_FORCE: u32 = 1 << 6;
const IS_DISABLED: u32 = 1 << 1;
/// GRSTCTL: flush the transmit FIFO with the given number.
const GRSTCTL: usize = 0x010;
const TXFFLSH: u32 = 1 << 5;
const TXFNUM_SHIFT: u32 = 6;
/// Timeout for a flag of an endpoint: twice the time of a packet of 64 bytes on the bus (USB 2.0, 5.8.3).
const FLAG_TICKS: u32 = 100 * crate::CLOCK_TICKS_PER_US;
/// DOEPCTL and DIEPCTL: the next packet is DATA0.
const SD0PID: u32 = 1 << 28;
/// Says when the driver enables an endpoint again. `true`: when it fetches a packet (OTG cores since that of the F446,
/// by their CID). `false`: when it takes the FIFO entry that ends the packet.
const IS_ENABLED_WITH_DATA: bool = cfg!(any(feature = "stm32f446", feature = "stm32f412"));
/// Index of the interface with the data endpoints: it is the class's second interface, after the control interface.
const DATA_INTERFACE: u16 = 1;

/// Address of the part's unique 96-bit number (RM0383, 24.1; RM0368, 24.1).
const UNIQUE_ID: usize = 0x1FFF_7A10;
/// Number of hexadecimal digits of the unique number.
const SERIAL_NUMBER: usize = 24;

fn read(offset: usize) -> u32 {
    let address = (pac::OTG_FS_GLOBAL::ptr() as usize + offset) as *const u32;
    // SAFETY: unsafe because a register is read by its address past the driver that owns it; safe because only the
    // offsets above are used, and only by the serial task, between the driver's calls. Reading GRXSTSP takes an entry
    // out of the FIFO; the driver keeps no account of entries.
    unsafe { address.read_volatile() }
}

fn write(offset: usize, word: u32) {
    let address = (pac::OTG_FS_GLOBAL::ptr() as usize + offset) as *mut u32;
    // SAFETY: unsafe because a register is written by its address past the driver that owns it; safe because only the
    // serial task writes, between the driver's calls, and only to GINTMSK, DAINTMSK, GRSTCTL and the registers of the
    // data endpoints. The driver does not act on the two masks. It finds the other registers in a state that a packet
    // or a bus reset could also have left.
    unsafe { address.write_volatile(word) }
}

/// Waits until these bits of a register have this value, for at most [`FLAG_TICKS`]. Returns whether they have it.
fn await_bits(offset: usize, bits: u32, value: u32) -> bool {
    let began = clock_ticks();
    while read(offset) & bits != value {
        if clock_ticks().wrapping_sub(began) > FLAG_TICKS {
            return false;
        }
    }
    true
}

/// Makes the next packet of an endpoint DATA0. Does not change whether the endpoint is enabled.
fn begin_with_data0(base: usize, endpoint: EndpointAddress) {
    let control = base + endpoint.index() * NEXT_ENDPOINT;
    write(control, read(control) & !ENABLED | SD0PID);
}

/// [`LATE_BYTES_US`] in ticks.
const LATE_BYTES_TICKS: u32 = LATE_BYTES_US * crate::CLOCK_TICKS_PER_US;

/// The class of the serial port, for the driver. After certain requests, the host restarts its data endpoints with
/// DATA0 (USB 2.0, 9.1.1.5 and 9.4.5). The driver does not reset its data toggles then: the next packet would seem to
/// be a repetition and be lost. So this class records which endpoints must restart with DATA0: `begin_out`,
/// `begin_in`.
struct SerialClass {
    port: CdcAcmClass<'static, UsbBusType>,
    begin_out: bool,
    begin_in: bool,
}

// This class wraps the class of the serial port. Two classes side by side would need a kilobyte more code: the
// compiler can resolve the calls of the driver only if there is one class.
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
            // These requests reset the data toggles of both data endpoints. With other values, the driver refuses them
            // and nothing changes.
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

/// The receiving part of the port: the packet fetched most recently.
struct Received {
    packet: [u8; PACKET],
    length: usize,
    next: usize,
    /// The end of the packet has been taken out of the FIFO; the endpoint must be enabled again.
    ended: bool,
    /// The driver may hold a packet: it has handled events, and each query since then has found a packet. Without this
    /// flag, each run of the serial task would query the driver, even a run for a byte of the UART. A query takes 4 us.
    may_wait: bool,
}

impl Received {
    /// Returns the bytes of the packet that have not been read yet.
    fn left(&self) -> &[u8] {
        self.packet.get(self.next..self.length).unwrap_or_default()
    }
}

/// The USB serial port.
pub struct UsbPort {
    device: UsbDevice<'static, UsbBusType>,
    class: SerialClass,
    received: Received,
    outgoing: heapless::Vec<u8, SENT>,
    host: UsbHost,
    /// The bus is being reset. Until the reset ends, the driver still reports the device as configured. But a packet
    /// written now would never be sent, and would keep the endpoint busy forever.
    resetting: bool,
    /// The interrupt of the receive FIFO is masked.
    masked: bool,
}

impl UsbPort {
    /// Switches OTG_FS on. Requires the 48 MHz clock. Call once.
    pub fn new(
        registers: (pac::OTG_FS_GLOBAL, pac::OTG_FS_DEVICE, pac::OTG_FS_PWRCLK),
        pins: (impl Into<alt::Dm>, impl Into<alt::Dp>),
        clocks: &Clocks,
    ) -> UsbPort {
        // OTG_FS needs 48 MHz within 0.25 % (USB 2.0, 7.1.11); with another clock it would never work.
        assert!(clocks.pll48clk().is_some_and(|clock| clock.raw() == 48_000_000), "no 48 MHz for USB");
        let usb = USB::new(registers, pins, clocks);
        let (Some(buffers), Some(number)) =
            (singleton!(: [u32; BUFFERS] = [0; BUFFERS]), singleton!(: [u8; SERIAL_NUMBER] = serial_number()))
        else {
            unreachable!()
        };
        let Some(bus) = singleton!(: usb_device::bus::UsbBusAllocator<UsbBusType> = UsbBus::new(usb, buffers)) else {
            unreachable!()
        };
        let class = CdcAcmClass::new(bus, PACKET as u16);
        let strings = StringDescriptors::default()
            .manufacturer("Oxmill")
            .product(crate::profile().name)
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

    /// Returns the kind of the first entry in the receive FIFO, if it belongs to the data endpoint.
    fn entry(&self) -> Option<u32> {
        let entry = (read(GINTSTS) & RXFLVL != 0).then(|| read(GRXSTSR))?;
        let data = (entry & EPNUM) as usize == self.class.port.read_ep().address().index();
        data.then_some(entry >> PKTSTS_SHIFT & PKTSTS)
    }

    /// Removes from the FIFO the entry that ends a data packet, if this entry is the first one there. If the driver
    /// found the entry first, it would enable the endpoint.
    fn hold_endpoint(&mut self) {
        if self.entry() == Some(OUT_COMPLETED) {
            read(GRXSTSP);
            self.received.ended = true;
        }
    }

    /// Makes the endpoint answer NAK until [`UsbPort::enable_endpoint`]. Needed on chips with `IS_ENABLED_WITH_DATA`,
    /// because their driver enables the endpoint as soon as it has fetched a packet. A packet that arrives before this
    /// function takes effect stays in the FIFO (see [`UsbPort::mask`]).
    fn refuse_packets(&mut self) {
        let control = DOEPCTL + self.class.port.read_ep().address().index() * NEXT_ENDPOINT;
        write(control, read(control) & !ENABLED | SNAK);
    }

    /// Allows the host to send exactly one more packet: a transfer of one packet, at whose end the endpoint is disabled
    /// (RM0383, 22.17.6, "Generic non-isochronous OUT data transfers"). Sets the size of the transfer, because the
    /// driver sets none when it enables the endpoint for the first time.
    fn enable_endpoint(&mut self) {
        let at = self.class.port.read_ep().address().index() * NEXT_ENDPOINT;
        let control = DOEPCTL + at;
        let before = read(control);
        // If the driver has already enabled the endpoint, the size of the transfer must not be changed.
        if before & ENABLED == 0 {
            write(DOEPTSIZ + at, ONE_PACKET);
        }
        write(control, before | ENABLED_AGAIN);
        self.received.ended = false;
    }

    /// Makes the next packet of an endpoint DATA0 if the host has restarted this endpoint with DATA0.
    fn begin_toggles(&mut self) {
        let SerialClass { port, begin_out, begin_in } = &mut self.class;
        if core::mem::take(begin_out) {
            begin_with_data0(DOEPCTL, port.read_ep().address());
        }
        if core::mem::take(begin_in) {
            begin_with_data0(DIEPCTL, port.write_ep().address());
        }
    }

    /// Masks or unmasks the interrupt of the receive FIFO. A packet can end just after [`UsbPort::hold_endpoint`] has
    /// looked at the FIFO; then the driver finds the end and enables the endpoint. If this happens twice in a row, a
    /// packet for which there is no space waits in the FIFO. Masking keeps this packet from raising the interrupt
    /// forever.
    fn mask(&mut self, masked: bool) {
        if masked != self.masked {
            self.masked = masked;
            let mask = read(GINTMSK);
            write(GINTMSK, if masked { mask & !RXFLVL } else { mask | RXFLVL });
        }
    }

    /// Returns true if a host has configured the device and the bus is not idle. The state of the driver alone is not
    /// reliable: after the bus has gone idle, data that arrived before makes the driver leave its suspended state.
    fn is_configured(&self) -> bool {
        self.device.state() == UsbDeviceState::Configured && !self.resetting && read(DSTS) & SUSPENDED == 0
    }

    /// Discards the bytes received from a host that has left, here and in the driver's buffer.
    fn forget_received(&mut self) {
        let _ = self.class.port.read_packet(&mut self.received.packet);
        self.received.length = 0;
        self.received.next = 0;
    }

    /// Discards the bytes queued for a host that has left, including a packet that the host has not fetched (RM0383,
    /// 22.17.6, "IN endpoint disable").
    fn forget_sent(&mut self) {
        self.outgoing.clear();
        let endpoint = self.class.port.write_ep().address().index();
        let control = DIEPCTL + endpoint * NEXT_ENDPOINT;
        let is_enabled = || read(control) & ENABLED != 0;
        if !is_enabled() {
            return;
        }
        // Clear flags that earlier operations have set.
        write(control + DIEPINT, NAK_IN_FORCE | IS_DISABLED);
        write(control, read(control) & !ENABLED | SNAK);
        let is_refused = await_bits(control + DIEPINT, NAK_IN_FORCE, NAK_IN_FORCE);
        if !is_enabled() {
            // The host has just fetched the packet.
            return;
        }
        if is_refused {
            write(control, read(control) & !ENABLED | DISABLED);
        }
        if is_refused && await_bits(control + DIEPINT, IS_DISABLED, IS_DISABLED) {
            write(GRSTCTL, (endpoint as u32) << TXFNUM_SHIFT | TXFFLSH);
            await_bits(GRSTCTL, TXFFLSH, 0);
        } else {
            // The packet cannot be removed from the transmit FIFO. It goes to the next host, which is better than an
            // endpoint that answers NAK forever.
            write(control, read(control) & !ENABLED | CNAK);
        }
    }

    /// Gives the queued bytes to the driver, if it can take a packet.
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
        // Call the driver only if there are events: it disables interrupts while it polls.
        let events = read(GINTSTS);
        if events & USBRST != 0 {
            self.resetting = true;
            // Call before the driver's `poll`. That function disables the endpoints without setting NAK first,
            // although the hardware requires NAK.
            self.forget_sent();
        }
        if events & EVENTS != 0 {
            let is_data = self.entry() == Some(OUT_DATA);
            self.device.poll(&mut [&mut self.class]);
            if IS_ENABLED_WITH_DATA && is_data {
                self.refuse_packets();
            }
            self.begin_toggles();
            self.received.may_wait = true;
            // The driver may just have fetched a packet from the FIFO. The entry that marks the end of the packet
            // usually follows there: take it out, too, without waiting for another interrupt.
            self.hold_endpoint();
        }
        if self.device.state() == UsbDeviceState::Default {
            // This state follows a reset of the bus, which has emptied the FIFO and enabled the endpoint. If a host
            // only withdraws the configuration, another state follows.
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
                    // Report the new host before its bytes are read. When a host arrives, the program discards a
                    // partial line. If it had already read bytes of the new host, it would discard a part of that
                    // host's first line.
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
        // While `room` is 0, the serial task fetches no packet. One packet can then be in `received`, one in the driver
        // and one in the FIFO. The one in the FIFO would raise its interrupt forever.
        self.mask(room == 0 && self.entry() == Some(OUT_DATA));
        let fetched = self.received.next >= self.received.length;
        if self.received.ended && fetched && room >= PACKET && self.is_configured() {
            self.enable_endpoint();
        }
    }

    fn send(&mut self, byte: u8) -> bool {
        if !self.is_configured() || !self.host.is_listening() {
            // Without a host, bytes are dropped, as on a UART without a cable.
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
            // A sent packet interrupts at its end, which calls the serial task. Enable this interrupt only if more
            // bytes wait.
            let endpoint = 1 << self.class.port.write_ep().address().index();
            let mask = read(DAINTMSK);
            let calls = if self.outgoing.is_empty() && !wanted { mask & !endpoint } else { mask | endpoint };
            if calls != mask {
                write(DAINTMSK, calls);
            }
        }
    }
}

/// Returns the chip's unique number in hexadecimal digits, by which a host distinguishes two boards.
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
