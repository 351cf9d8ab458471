"""OTG_FS as a full-speed device (RM0383 chapter 22), with an interface for the host at the other end of the cable.

Modelled: soft connect; bus reset and end of enumeration; suspend and wake-up; the receive FIFO with its status entries
(a packet and, a moment later, its end); NAK and enable of endpoints; transmit FIFOs; transfer-complete of IN endpoints;
the interrupt. After a packet, an OUT endpoint answers NAK until it is enabled again; a SETUP packet is always accepted.
A packet that arrives while its predecessor is unread stays in the FIFO. Each data endpoint has its data toggle: an OUT
packet with the wrong toggle is taken for a repetition, answered by ACK and dropped.
Not modelled: the host role, isochronous transfers, SOF, VBUS sensing (which must be off), errors on the bus, FIFO sizes
except their sum, EP0's STALL beyond the current transfer, transfers of more than one packet, CRC.
"""

from .peripheral import NEVER, Misuse, Peripheral, Unmodelled

GOTGCTL, GAHBCFG, GUSBCFG, GRSTCTL, GINTSTS, GINTMSK = 0x000, 0x008, 0x00C, 0x010, 0x014, 0x018
GRXSTSR, GRXSTSP, GRXFSIZ, DIEPTXF0, GCCFG, CID = 0x01C, 0x020, 0x024, 0x028, 0x038, 0x03C
DIEPTXF = (0x104, 0x108, 0x10C, 0x110, 0x114)
DCFG, DCTL, DSTS, DIEPMSK, DOEPMSK, DAINTMSK, PCGCCTL = 0x800, 0x804, 0x808, 0x810, 0x814, 0x81C, 0xE00
IN, OUT, FIFO = 0x900, 0xB00, 0x1000
USBSUSP, USBRST, ENUMDNE, WKUPINT, RXFLVL, IEPINT = 1 << 11, 1 << 12, 1 << 13, 1 << 31, 1 << 4, 1 << 18
USBAEP, NAKSTS, STALL, CNAK, SNAK, EPDIS, EPENA = 1 << 15, 1 << 17, 1 << 21, 1 << 26, 1 << 27, 1 << 30, 1 << 31
EPDISD, INEPNE = 1 << 1, 1 << 6
SD0PID, SD1PID = 1 << 28, 1 << 29
OUT_DATA, OUT_DONE, SETUP_DONE, SETUP_DATA = 2, 3, 4, 6
ENDPOINTS, FIFO_WORDS = 6, 320
"""RM0390, "OTG_FS main features": endpoint 0 and five more, 1.25 Kbytes of FIFO. RM0383 has endpoint 0 and three more."""
OLD_CORES = (0x1100, 0x1200)
"""CID (version of the USB core) of the chips with three data endpoints: 0x1100 (RM0090), 0x1200 (RM0383, RM0368)."""
END_S = 0.5e-6
"""Seconds from a packet to the entry that marks its end."""


class OtgFs(Peripheral):
    CLOCK = (0x34, 7)
    IRQ = 67
    PLAIN = (GOTGCTL, GAHBCFG, GUSBCFG, GINTMSK, GRXFSIZ, DIEPTXF0, GCCFG, *DIEPTXF, DCFG, DCTL, DIEPMSK, DOEPMSK, DAINTMSK, PCGCCTL)

    def __init__(self, name, board):
        self.host = None
        """The host; its `step()` is called when its `due` time has come."""
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.values = dict.fromkeys(self.PLAIN, 0)
        # Not connected until DCTL.SDIS is cleared by software.
        self.values[DCTL] = 2
        self.flags = 0
        self.suspended = False
        self.fifo, self.words = [], []
        """`fifo`: entries (cycle, endpoint, bytes, status). `words`: unread words of the data entry that was popped
        last."""
        self.control = {(side, n): 0 for side in (IN, OUT) for n in range(ENDPOINTS)}
        self.size = dict(self.control)
        self.toggle = dict(self.control)
        """Toggle that each data endpoint sends or expects next: 0 for DATA0."""
        self.complete = [0] * ENDPOINTS
        self.sending = [bytearray() for _ in range(ENDPOINTS)]

    # Registers.

    def _entries(self):
        return [entry for entry in self.fifo if entry[0] <= self.board.now]

    def _status(self):
        status = self.flags | (RXFLVL if self._entries() else 0)
        mask = self.values[DAINTMSK]
        if any(self.complete[n] & self.values[DIEPMSK] and mask >> n & 1 for n in range(ENDPOINTS)):
            status |= IEPINT
        return status

    def call(self):
        up = self.values[GAHBCFG] & 1 and self._status() & self.values[GINTMSK]
        self.board.nvic.level(self.IRQ, bool(up))

    def _endpoint(self, offset):
        side, number, register = offset & ~0x1FF | 0x100, offset >> 5 & 7, offset & 0x1F
        if side not in (IN, OUT) or number >= ENDPOINTS:
            raise Unmodelled(f"OTG_FS has no model of the register at {offset:#05x}")
        return side, number, register

    def read(self, offset):
        if offset >= FIFO:
            if not self.words:
                raise Misuse("OTG_FS: the receive FIFO is read while it holds no data")
            return self.words.pop(0)
        if offset in self.values:
            return self.values[offset]
        if offset == GRSTCTL:
            return 1 << 31
        if offset == GINTSTS:
            return self._status()
        if offset in DIEPTXF[3:] and self.board.part.otg_id in OLD_CORES:
            raise Unmodelled("this OTG_FS has three data endpoints")
        if offset == CID:
            return self.board.part.otg_id
        if offset == DSTS:
            return 3 << 1 | self.suspended
        if offset in (GRXSTSR, GRXSTSP):
            entries = self._entries()
            if not entries:
                raise Misuse("OTG_FS: the status of an empty receive FIFO is read")
            _, endpoint, data, status = entries[0]
            if offset == GRXSTSP:
                if self.words:
                    raise Misuse("OTG_FS: an entry is taken while data of the one before is unread")
                self.fifo.remove(entries[0])
                padded = data + bytes(-len(data) % 4)
                self.words = [int.from_bytes(padded[i : i + 4], "little") for i in range(0, len(padded), 4)]
                self.call()
            return status << 17 | len(data) << 4 | endpoint
        side, number, register = self._endpoint(offset)
        if register == 0x00:
            return self.control[side, number]
        if register == 0x08:
            return self.complete[number] if side == IN else 0
        if register == 0x10:
            return self.size[side, number]
        if register == 0x18 and side == IN:
            return 16 - (len(self.sending[number]) + 3) // 4
        raise Unmodelled(f"OTG_FS has no model of the register at {offset:#05x}")

    def write(self, offset, value):
        if offset >= FIFO:
            number = (offset >> 12) - 1
            need = self.size[IN, number] & 0x7F
            if not self.control[IN, number] & EPENA or len(self.sending[number]) >= need:
                raise Misuse(f"OTG_FS: a word for IN endpoint {number} that no transfer asks for")
            self.sending[number] += value.to_bytes(4, "little")
            del self.sending[number][need:]
            if self.host and len(self.sending[number]) == need:
                self.host.wake()
            return
        if offset == GINTSTS:
            self.flags &= ~value
        elif offset == GRSTCTL:
            if value & 1:
                self.reset()
            if value & 1 << 4:
                self.fifo.clear()
                self.words.clear()
            if value & 1 << 5:
                number = value >> 6 & 31
                if number != 16 and self.control[IN, number] & EPENA:
                    raise Misuse(f"OTG_FS: the FIFO of IN endpoint {number} is emptied while it is enabled")
                for n in range(ENDPOINTS) if number == 16 else (number,):
                    self.sending[n].clear()
        elif offset in self.values:
            self.values[offset] = value
            words = [self.values[GRXFSIZ] & 0xFFFF] + [self.values[r] >> 16 for r in (DIEPTXF0, *DIEPTXF)]
            if sum(words) > FIFO_WORDS:
                raise Misuse(f"OTG_FS: FIFOs of {words} words do not fit into {FIFO_WORDS}")
            if offset == DCTL and self.host:
                self.host.look()
        else:
            self._write_endpoint(*self._endpoint(offset), value)
            if self.host:
                self.host.wake()
        self.call()

    def _write_endpoint(self, side, number, register, value):
        if register == 0x00:
            before = self.control[side, number]
            after = value & ~(CNAK | SNAK | EPDIS | NAKSTS | EPENA | SD0PID | SD1PID) | before & (NAKSTS | EPENA)
            if value & (SD0PID | SD1PID):
                self.toggle[side, number] = int(not value & SD0PID)
            in_force = self.complete[number] & INEPNE
            if value & CNAK:
                after &= ~NAKSTS
                if side == IN:
                    self.complete[number] &= ~INEPNE
            if value & SNAK:
                after |= NAKSTS
                if side == IN:
                    self.complete[number] |= INEPNE
            if value & EPENA:
                after |= EPENA
            if value & EPDIS:
                if side == IN:
                    if not in_force:
                        raise Misuse(f"OTG_FS: IN endpoint {number} is disabled before its NAK is in force")
                    self.complete[number] |= EPDISD
                after &= ~EPENA
            self.control[side, number] = after
        elif register == 0x08:
            if side == IN:
                self.complete[number] &= ~value
        elif register == 0x10:
            # The check leaves out endpoint 0, because the driver writes the size of endpoint 0 at a bus reset, for the
            # next SETUP packets.
            if side == OUT and number and self.control[side, number] & EPENA:
                raise Misuse(f"OTG_FS: the size of OUT endpoint {number} is written while it is enabled")
            self.size[side, number] = value
        else:
            raise Unmodelled(f"OTG_FS: register {register:#x} of an endpoint")

    # The bus, for the host.

    @property
    def connected(self):
        return self.values[GCCFG] >> 16 & 1 and not self.values[DCTL] & 2

    def flag(self, flag):
        self.flags |= flag
        self.suspended = flag == USBSUSP
        self.call()

    def setup(self, data):
        """Delivers a SETUP packet, which is always accepted. Afterwards both directions of the control endpoint answer
        NAK."""
        now = self.board.now
        self.fifo += [(now, 0, bytes(data), SETUP_DATA), (now + self.board.cycles(END_S), 0, b"", SETUP_DONE)]
        self.control[IN, 0] &= ~STALL
        self.control[OUT, 0] = self.control[OUT, 0] & ~(EPENA | STALL) | NAKSTS
        self.call()

    def out(self, number, data, toggle=None):
        """Delivers an OUT packet. Returns True for ACK, False for NAK, None for STALL. Without `toggle`, the toggle is
        assumed to be right."""
        control = self.control[OUT, number]
        if control & STALL:
            return None
        if control & NAKSTS or not control & EPENA or number and not control & USBAEP:
            return False
        if toggle is not None:
            if toggle != self.toggle[OUT, number]:
                return True
            self.toggle[OUT, number] ^= 1
        now = self.board.now
        self.fifo += [(now, number, bytes(data), OUT_DATA), (now + self.board.cycles(END_S), number, b"", OUT_DONE)]
        self.control[OUT, number] = control & ~EPENA | NAKSTS
        self.call()
        return True

    def in_(self, number):
        """Sends an IN token. Returns the packet, False for NAK, None for STALL. The packet's toggle is the value of
        `toggle` before the call."""
        control = self.control[IN, number]
        if control & STALL:
            return None
        need = self.size[IN, number] & 0x7F
        if control & NAKSTS or not control & EPENA or len(self.sending[number]) < need:
            return False
        data = bytes(self.sending[number])
        self.sending[number].clear()
        self.toggle[IN, number] ^= 1
        self.control[IN, number] = control & ~EPENA | NAKSTS
        self.size[IN, number] = 0
        self.complete[number] |= 1
        self.call()
        return data

    def advance(self, now):
        self.call()
        self.plan(self.host.step(now) if self.host else NEVER)
