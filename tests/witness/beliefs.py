"""The firmware's beliefs (assumptions) about the hardware, each with its source and a check in labwired, a chip
emulator that is independent of this project.

`ACTS`: the behaviour of labwired's model is the check, because with a wrong belief the firmware would not get this far.
`FIELDS`: the check reads back a value that the firmware wrote, and splits it by ST's names for its bits; the meaning of
the bits is from the manual. `NOT_MODELLED`: beliefs that labwired cannot check.

Manuals: RM0383 for the STM32F411, PM0214 for its processor.
"""

import re

from . import chip
from .machine import Broken

ACTS, FIELDS = "acts", "fields"
BAUD = 115_200
GREETING = b"Grbl 1.1h ['$' for help]\r\n"
SAMPLE_HZ, DWELL_S = 20_000, 0.003
DRAWN = {"$100": "80.000", "$101": "81.000"}
"""Settings that the checks store, and their values in the list of settings."""
BELIEFS = []
NOT_MODELLED = (
    ("flash refuses what comes without its keys, and words at a wrong parallelism", "the lock holds nothing; the keys are compared with the manual's"),
    ("a step comes out: TIM5 starts TIM1, its compare events ask DMA2 for a word of BSRR", "timers without slave mode, and requests that move nothing"),
    ("the stream of the moments counts a word when it writes it, not when it fetches it", "a count goes down when a stream is switched on"),
    ("a compare value that is written where the counter is gives no match", "no timer is looked at so closely"),
    ("DMA2 reads memory through its peripheral port and writes BSRR through the other, within so many cycles", "no arbitration, no bus"),
    ("TIM1 counts while the processor sleeps (RCC_APB2LPENR)", "the register keeps nothing; sleep stops no clock"),
    ("the core at its rate from this crystal", "registers of RCC are kept, and no frequency follows; the rate is computed here"),
    ("without DMA: the interrupt of a received byte (RXNEIE), what DMA2 receives while flash is written", "this program pends the interrupt; no time passes there"),
    ("with DMA: what the UART asks DMA1 for", "this program moves bytes and counts them; flag and interrupt of the end are labwired's"),
    ("errors and overrun of the UART (EIE)", "bytes only"),
    ("the time of a byte, of a flash operation, of a start of the oscillator", "all at once"),
    ("erratum 2.2.11 (GPIO behind DMA2's peripheral port), caches, wait states", "no model"),
    ("the watchdog of clock, supply and program (CSS, PVD, IWDG) acts", "registers only"),
    ("USB beyond the registers of its core", "no bus, no FIFO"),
    ("what a debugger freezes", "no model"),
    ("a reset of the peripherals", "it resets the processor alone; this program switches SysTick and interrupts off"),
    ("LDREXH and STREXH", "not in labwired's processor; replaced in the image"),
    ("DSP and floating-point instructions", "not in the target of this image"),
    ("STM32F446: over-drive, two ports at 180 MHz; STM32F401", "no F446 in the package; its F401 is not tried here"),
)
"""(belief, what labwired does instead)."""


def belief(title, how, source):
    def keep(check):
        BELIEFS.append((title, how, source, check))
        return check

    return keep


def _pins(machine, port, register="ODR"):
    return machine.value(f"gpio{port.lower()}", register)


def _level(machine, pin):
    return _pins(machine, pin[0]) >> int(pin[1:]) & 1


def _mode(machine, pin):
    return machine.field(f"gpio{pin[0].lower()}", "MODER", f"MODER{pin[1:]}")


@belief("the vectors lie where flash begins; oscillator, PLL, voltage and switch answer in this order, and the board greets", ACTS, "RM0383 2.4, 6.2, PWR_CSR")
def greets(machine, _):
    machine.until(GREETING, 0.04)
    for name in ("HSERDY", "PLLRDY"):
        machine.expect("rcc", "CR", **{name: 1})
    return f"greeting after {machine.sim.time * 1000:.1f} ms of machine time"


@belief("PLL and prescalers make the board's clock of its crystal", FIELDS, "RM0383 RCC_PLLCFGR, RCC_CFGR")
def clock(machine, board):
    def number(name, bits):
        return sum(machine.field("rcc", "PLLCFGR", f"{name}{bit}") << bit for bit in range(bits))

    source = machine.expect("rcc", "CR", HSEBYP=int(board.hse_bypass))
    machine.expect("rcc", "PLLCFGR", PLLSRC=1)
    switched = [machine.field("rcc", "CFGR", f"SWS{bit}") for bit in (0, 1)]
    if switched != [0, 1]:
        raise Broken(f"the core's clock is not the PLL: SWS0 and SWS1 are {switched}")
    input_hz = board.hse_hz / number("PLLM", 6)
    vco_hz = input_hz * number("PLLN", 9)
    core_hz = vco_hz / (2 * number("PLLP", 2) + 2)
    if not 0.95e6 <= input_hz <= 2.1e6 or not 100e6 <= vco_hz <= 432e6:
        raise Broken(f"the PLL gets {input_hz / 1e6:.2f} MHz and runs at {vco_hz / 1e6:.0f} MHz, which the manual forbids")
    if core_hz != board.core_hz:
        raise Broken(f"the core runs at {core_hz / 1e6:.3f} MHz and not at {board.core_hz / 1e6:.0f}")
    return f"{source}, {board.hse_hz / 1e6:.0f} MHz / {number('PLLM', 6)} * {number('PLLN', 9)} / {2 * number('PLLP', 2) + 2}"


@belief("wait states and voltage scale fit that clock", FIELDS, "RM0383 3.4.1 table 5, PWR_CR")
def wait_states(machine, board):
    # From 2.7 V on, flash needs 0 wait states up to 30 MHz, 1 up to 64 MHz, 2 up to 90 MHz, and 3 up to 100 MHz. Above
    # 84 MHz, voltage scale 1 (VOS = 3) is required.
    states = sum(board.core_hz > limit * 1_000_000 for limit in (30, 64, 90))
    return machine.expect("flash_ctrl", "ACR", LATENCY=states) + ", " + machine.expect("pwr", "CR", VOS=3)


@belief("each peripheral has its clock: one whose enable bit is off takes no write", ACTS, "RM0383 RCC_AHB1ENR, APB1ENR, APB2ENR")
def gates(machine, _):
    used = {
        "AHB1ENR": ("GPIOAEN", "GPIOBEN", "DMA1EN", "DMA2EN"),
        "APB1ENR": ("TIM2EN", "TIM3EN", "TIM5EN", "PWREN"),
        "APB2ENR": ("TIM1EN", "SYSCFGEN", f"{machine.uart.upper()}EN"),
    }
    for register, names in used.items():
        there = machine.schema("rcc")[register][1]
        machine.expect("rcc", register, **{name: 1 for name in names if name in there})
    return "all that are used are on"


@belief("the UART sends: its pin's alternate function, the interrupt that it sends by and its place in the vectors", ACTS, "RM0383 19.6, 10.2; data sheet, alternate functions")
def sends(machine, board):
    tx = {"usart1": ("A9", "AFRH", "AFRH9"), "usart2": ("A2", "AFRL", "AFRL2")}[machine.uart]
    if _mode(machine, tx[0]) != 2:
        raise Broken(f"{tx[0]} is not in its alternate function")
    machine.expect("gpioa", tx[1], **{tx[2]: 7})
    machine.expect(machine.uart, "CR1", UE=1, TE=1, RE=1, M=0, PCE=0)
    return f"P{tx[0]} by AF7, interrupt of {f'stream {machine.sender}' if machine.dma else machine.uart.upper()}"


@belief("what serves the UART: DMA in both directions, or its interrupt and DMA while flash is written; channel 4 is the UART's", FIELDS, "RM0383 19.6, DMA1 and DMA2 request mapping, DMA_SxCR")
def served(machine, _):
    def stream(dma, number, **wanted):
        control = machine.expect(dma, f"S{number}CR", CHSEL=4, MINC=1, PINC=0, **wanted)
        if (at := machine.value(dma, f"S{number}PAR")) != machine.address(machine.uart, "DR"):
            raise Broken(f"the peripheral of stream {number} is at {at:#x}")
        return control

    if not machine.dma:
        told = [machine.expect(machine.uart, "CR1", RXNEIE=1), machine.expect(machine.uart, "CR3", DMAR=0, DMAT=0)]
        told.append(stream("dma2", 5, DIR=0, PSIZE=1, MSIZE=1, CIRC=0))
    else:
        told = [machine.expect(machine.uart, "CR1", RXNEIE=0, TXEIE=0), machine.expect(machine.uart, "CR3", EIE=1, DMAR=1, DMAT=1)]
        told.append(stream(machine.dma, machine.receiver, DIR=0, PSIZE=1, MSIZE=1, CIRC=1))
        told.append(stream(machine.dma, machine.sender, DIR=1, PSIZE=0, MSIZE=0, CIRC=0, TCIE=1))
    return ", ".join(told)


@belief("its rate is 115200 baud within 0.5 %", FIELDS, "RM0383 USART_BRR")
def baud(machine, board):
    bus_hz = board.part.apb2_hz if machine.uart == "usart1" else board.part.apb1_hz
    bus_hz = bus_hz * board.core_hz // board.part.core_hz
    whole, sixteenths = (machine.field(machine.uart, "BRR", f"DIV_{part}") for part in ("Mantissa", "Fraction"))
    rate = bus_hz / (16 * whole + sixteenths)
    if abs(rate / BAUD - 1) > 0.005:
        raise Broken(f"the UART runs at {rate:.0f} baud")
    return f"{whole} + {sixteenths}/16 of {bus_hz / 1e6:.0f} MHz: {rate:.0f} baud"


@belief("USB: the core is reset, its FIFOs are flushed, it is a device and connects to the bus", ACTS, "RM0383 chapter 22, OTG_FS_GUSBCFG, OTG_FS_DCTL")
def usb(machine, board):
    if not board.usb:
        return "this board has none"
    machine.expect("rcc", "AHB2ENR", OTGFSEN=1)
    base = next(p["base_address"] for p in machine.description["peripherals"] if p["type"] == "usb_otg")

    def field(part, at, register, name):
        offset, bits = chip.fields(f"otg_fs_{part}")[register]
        lowest, mask = bits[name]
        return machine.sim.read_u32(base + at + offset) >> lowest & mask

    found = [field("global", 0, "FS_GUSBCFG", "FDMOD"), field("device", 0x800, "FS_DCFG", "DSPD"), field("device", 0x800, "FS_DCTL", "SDIS")]
    if found != [1, 3, 0]:
        raise Broken(f"FDMOD, DSPD and SDIS are {found}")
    return "FDMOD=1 DSPD=3 SDIS=0"


@belief("SysTick samples the inputs 20,000 times a second", FIELDS, "PM0214 4.5.2, STK_LOAD")
def samples(machine, board):
    reload = machine.sim.read_u32(0xE000_E014)
    if (reload + 1) * SAMPLE_HZ != board.core_hz:
        raise Broken(f"SysTick counts {reload + 1} cycles")
    return f"{reload + 1} cycles"


@belief("the supply is watched, and its interrupt is that of EXTI line 16; the independent watchdog has 2 s", FIELDS, "RM0383 PWR_CR, EXTI_IMR, IWDG_PR, IWDG_RLR")
def watches(machine, _):
    supply = machine.expect("pwr", "CR", PVDE=1, PLS=7)
    line = machine.expect("exti", "IMR", MR16=1)
    # LSI at 32 kHz, divided by 4 << PR.
    seconds = (machine.field("iwdg", "RLR", "RL") + 1) * (4 << machine.field("iwdg", "PR", "PR")) / 32_000
    if not 1.9 <= seconds <= 2.1:
        raise Broken(f"the watchdog has {seconds:.2f} s")
    return f"{supply}, {line}, {seconds:.2f} s"


@belief("`?`, `$I`, `$$` and more lines than the UART's buffer holds are answered", ACTS, "docs/senders.md")
def answers(machine, _):
    if not machine.status().startswith("<Idle|MPos:0.000,0.000,0.000|"):
        raise Broken("`?` is not answered by an idle machine at 0")
    if "[VER:1.1h." not in machine.ask("$I"):
        raise Broken("`$I` has no version")
    lines = machine.ask("$$", 0.1).split("\r\n")[:-2]
    numbers = [int(found[1]) for line in lines if (found := re.fullmatch(r"\$(\d+)=-?[0-9.]+", line))]
    if len(numbers) != len(lines) or not set(range(7)) | {100, 101, 102, 130, 131, 132} <= set(numbers):
        raise Broken(f"`$$` has other lines than settings, or lacks some: {lines}")
    if any(f"{name}={value}" in lines for name, value in DRAWN.items()):
        raise Broken("a setting that is to be stored has that value already")
    # Together, these comments are longer than the 320 slots of the UART's buffer.
    for _ in range(5):
        machine.ask(f"({'-' * 64})")
    return f"{len(lines)} settings"


@belief("an input that goes low is seen: pull-up, port, place in the word", ACTS, "RM0383 8.4, GPIOx_IDR")
def inputs(machine, board):
    for name, letter in (("probe", "P"), ("limit_x", "X")):
        machine.sim.set_pin(name, True)
        # 0.6 ms are twelve samples of the inputs; the filter needs eight.
        machine.run(0.0006)
        said = machine.status()
        machine.sim.set_pin(name, False)
        machine.run(0.0006)
        if f"|Pn:{letter}" not in said or "|Pn:" in machine.status():
            raise Broken(f"{name} low and high again is not seen: {said!r}")
    return f"P{board.probe} and P{board.limits[0]}"


@belief("slow outputs: flood and spindle go high, and low at the end; the drivers' enable is off at rest", ACTS, "RM0383 GPIOx_MODER, GPIOx_BSRR")
def outputs(machine, board):
    def levels():
        return [_level(machine, pin) for pin in (board.flood, board.spindle)]

    seen = [levels()]
    for line in ("M8", "M3 S500"):
        machine.ask(line)
        machine.run(0.0005)
        seen.append(levels())
    if seen != [[0, 0], [1, 0], [1, 1]] or _level(machine, board.enable) != 1:
        raise Broken(f"flood and spindle, at rest, after M8, after M3: {seen}")
    return f"P{board.flood}, P{board.spindle}, P{board.enable}"


@belief("the spindle's PWM: TIM3 channel 2 at 5 kHz and half power, on its pin", FIELDS, "RM0383 13.3.9, TIMx_CCMR1, TIMx_CCER")
def pwm(machine, board):
    machine.expect("tim3", "CCMR1_Output", OC2M=6, OC2PE=0)
    machine.expect("tim3", "CCER", CC2E=1)
    if _mode(machine, board.pwm) != 2:
        raise Broken(f"P{board.pwm} is not in its alternate function")
    machine.expect("gpioa", "AFRL", AFRL7=2)
    period, high = machine.value("tim3", "ARR") + 1, machine.value("tim3", "CCR2")
    rate = board.core_hz / period / (machine.value("tim3", "PSC") + 1)
    for line in ("M5", "M9"):
        machine.ask(line)
    if not abs(rate - 5000) < 5 or not 0.49 < high / period < 0.51:
        raise Broken(f"{rate:.0f} Hz, {high} of {period} counts high")
    machine.run(0.0005)
    if machine.value("tim3", "CCR2"):
        raise Broken("M5 leaves a compare value")
    return f"{high} of {period} counts, 0 after M5"


@belief("the microsecond clock: TIM2 behind its prescaler, a dwell of 3 ms takes 3 ms", ACTS, "RM0383 13.4.11, TIMx_PSC")
def dwells(machine, _):
    machine.send(f"G4 P{DWELL_S}\n".encode())
    begin = machine.sim.time
    machine.until(b"ok\r\n", 0.02)
    took = machine.sim.time - begin
    # There are two tolerances: the output is checked only every 0.2 ms, and the time includes reading and planning the
    # line.
    if not DWELL_S - 0.0002 <= took <= DWELL_S + 0.0006:
        raise Broken(f"it took {took * 1000:.2f} ms")
    return f"{took * 1000:.2f} ms"


@belief("realtime bytes in the middle of a line act and leave it whole", ACTS, "docs/senders.md")
def realtime(machine, _):
    # A status report and a feed override of +10 %.
    machine.send(b"$10?1=8\x911\n")
    said = machine.until(b"ok\r\n", 0.05)
    if not re.match(r"<Idle\|.*>\r\nok\r\n$", said):
        raise Broken(f"the line that stores $101 with a report in it brings {said!r}")
    reports = [machine.status() for _ in range(2)]
    if not any("|Ov:110,100,100" in report for report in reports):
        raise Broken(f"the override is not in {reports}")
    return "a report before the `ok`, Ov:110, and $101"


@belief("a word is programmed in sector 1 or 2, and the interface is locked again", ACTS, "RM0383 3.5, FLASH_CR")
def stores(machine, _):
    machine.ask("$100=80")
    machine.run(0.002)
    machine.expect("flash_ctrl", "CR", LOCK=1, PG=0)
    sectors = machine.sim.read_memory(0x0800_4000, 0x8000)
    used = [number for number in (1, 2) if set(sectors[0x4000 * (number - 1) : 0x4000 * number]) != {0xFF}]
    if not used:
        raise Broken("nothing is written in the sectors of the settings")
    return f"sector {used[0]}: {0x8000 - sectors.count(0xFF)} bytes that are not 0xFF"


@belief("flash is unlocked by these two keys in this order", FIELDS, "RM0383 3.5.1")
def keys(machine, _):
    # labwired requires no key: in this machine the registers of the flash interface are plain memory. So a value
    # written to KEYR can be read back.
    register = machine.address("flash_ctrl", "KEYR")
    # At its first start the firmware writes to flash. Run in steps of 20 us until the first key has been written,
    # return to the last state before that, and continue in small steps.
    while True:
        before = machine.sim.snapshot()
        machine.run(0.000_02)
        if machine.sim.read_u32(register):
            break
        if machine.sim.time > 0.04:
            raise Broken("no key is written")
    machine.sim.restore(before)
    # `restore` does not restore the plain memory, so clear the register.
    machine.sim.write_u32(register, 0)
    written = [0]
    for _ in range(2000):
        machine.run(0.000_000_02)
        if (now := machine.sim.read_u32(register)) != written[-1]:
            written.append(now)
        if len(written) == 3:
            break
    if written[1:] != [0x4567_0123, 0xCDEF_89AB]:
        raise Broken(f"KEYR gets {', '.join(f'{key:#010x}' for key in written[1:])}")
    return "0x45670123, 0xCDEF89AB"


@belief("what was stored is there after a reset", ACTS, "docs/storage.md; PM0214 4.4.5, AIRCR")
def keeps(machine, _):
    machine.reset()
    machine.until(GREETING, 0.04)
    lines = machine.ask("$$", 0.1).split("\r\n")
    for name, value in DRAWN.items():
        if f"{name}={value}" not in lines:
            raise Broken(f"{name} is {[line for line in lines if line.startswith(name + '=')]} and not {value}")
    # A failure since the reset would have raised an alarm.
    if not (status := machine.status()).startswith("<Idle|"):
        raise Broken(f"the state is {status!r}")
    return ", ".join(f"{name}={value}" for name, value in DRAWN.items())


@belief("the stream of the moments leads from memory to TIM5's compare register; channel 6 is TIM5's", FIELDS, "RM0383 chapter 9, DMA1 request mapping, DMA_SxCR")
def moments(machine, board):
    machine.send(b"G1 X0.1 F500\n")
    end = machine.sim.time + 0.01
    while not machine.field("dma1", "S2CR", "EN"):
        if machine.sim.time > end:
            raise Broken("no motion begins")
        machine.run(0.000_005)
    control = machine.expect("dma1", "S2CR", CHSEL=6, DIR=1, MINC=1, PINC=0, PSIZE=2, MSIZE=2, CIRC=1, PL=3)
    to, ring = machine.value("dma1", "S2PAR"), machine.value("dma1", "S2M0AR")
    if to != machine.address("tim5", "CCR1"):
        raise Broken(f"its peripheral is at {to:#x}")
    first, second = (machine.sim.read_u32(ring + offset) for offset in (0, 4))
    # The steps of this move are a few milliseconds apart, the first two steps even more.
    apart = (second - first & 0xFFFF_FFFF) / board.core_hz
    if not 0.0001 < apart < 0.1:
        raise Broken(f"the ring has moments {apart * 1000:.3f} ms apart")
    return f"{control}; the next step {apart * 1000:.1f} ms later"


@belief("a chain that puts no step out is noticed: the alarm locks the machine, and the position is that of the pins", ACTS, "boards/stm32f4/chain.rs")
def chain_is_watched(machine, _):
    said = machine.until(b"ALARM:103\r\n[MSG:Step outputs have failed]\r\n", 0.02)
    status = machine.status()
    if "ok\r\n" not in said or not status.startswith("<Alarm|MPos:0.000,0.000,0.000|"):
        raise Broken(f"the line is answered by {said!r}, and the state is {status!r}")
    return "ALARM:103, position 0, no step counted"


@belief("the streams of the edges read memory as a peripheral that counts up and write BSRR; channel 6 is TIM1's", FIELDS, "RM0383 chapter 9, DMA2 request mapping, GPIOx_BSRR")
def edges(machine, board):
    ports = sorted({pin[0] for pin in board.step + board.direction + (board.second_step, board.second_direction)})
    # The key is the number of ports with step or direction pins. The value lists the DMA2 streams. True: the stream
    # outputs the rising edge. False: it outputs the end of the pulse. The requests come from TIM1: channel 1 requests
    # stream 1, channel 2 stream 2, channel 3 stream 6, and channel 4 stream 4.
    streams = {1: {1: True, 4: False}, 2: {1: True, 2: False, 6: True, 4: False}}[len(ports)]
    told = []
    for stream, counts in streams.items():
        machine.expect("dma2", f"S{stream}CR", CHSEL=6, DIR=0, PINC=int(counts), MINC=0, PSIZE=2, MSIZE=2, CIRC=1, PL=3)
        to, memory = machine.value("dma2", f"S{stream}M0AR"), machine.value("dma2", f"S{stream}PAR")
        if to not in [machine.address(f"gpio{port.lower()}", "BSRR") for port in ports] or not 0x2000_0000 <= memory < 0x2002_0000:
            raise Broken(f"stream {stream} goes from {memory:#x} to {to:#x}")
        told.append(f"S{stream}")
    return f"DMA2 {', '.join(told)}, port{'s' if len(ports) > 1 else ''} {' and '.join(ports)}"


@belief("TIM5 puts its compare event of channel 1 out as a trigger, TIM1 makes one pulse of $0", FIELDS, "RM0383 TIMx_CR2, TIM1_CR1, TIM1_DIER")
def pulse(machine, board):
    machine.expect("tim5", "CR2", MMS=3)
    machine.expect("tim1", "CR1", OPM=1)
    machine.expect("tim1", "SMCR", TS=0)
    on, off = machine.value("tim1", "CCR1"), machine.value("tim1", "CCR4")
    if (off - on) * 1_000_000 != 10 * board.core_hz:
        raise Broken(f"the pulse has {off - on} counts and not 10 us")
    return f"{off - on} counts: 10 us"


@belief("a reset in an alarm brings the greeting again", ACTS, "docs/senders.md")
def locked(machine, _):
    machine.send(b"\x18")
    said = machine.until(GREETING, 0.02)
    return repr(said.strip().split("\r\n")[-1])
