#!/usr/bin/env python3
"""Streams a job in checked lines: the job runs as written even if the link damages, drops or doubles bytes.

    python3 examples/checked_sender.py JOB.nc --tcp 127.0.0.1:2323
    python3 examples/checked_sender.py JOB.nc --serial /dev/ttyACM0 [--baud 115200]

`docs/senders.md` describes the lines. While the machine holds (M0, M6, a feed hold), Enter resumes it. Ctrl-C holds the
machine and ends the sender. Exit status: 0 if all lines have been taken; 1 if the machine refuses a line, locks itself
or is reset. Needs only Python 3.9; a serial port needs Linux or macOS.
"""

import argparse
import binascii
import contextlib
import os
import random
import re
import select
import socket
import sys
import threading
import time

DIGITS = "ABDGHKNPSUVZcefi"
SUBSTITUTES = str.maketrans(" #%)189>XY", "shpdlbgtxy")
NUMBERS = 4096
# The session's letters are capitals that one damaged bit cannot turn into a realtime command.
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWZ"
# Maximum number of answers in a row that are damaged or of another session. If there are more, another sender must be
# using the machine.
STRANGE = 32
# Maximum number of bytes of lines that have been sent and not answered; the machine has room for 255.
WINDOW = 120
# After this many seconds without an answer, the sender sends a question: an empty line, which is one byte.
PATIENCE = 0.5
# Maximum number of unanswered questions.
QUESTIONS = 32
# After this many seconds without a byte, the link counts as dead, because the machine sends the requested reports in
# every state.
SILENCE = 20.0
# Maximum length of a line with its comments: four times what the machine accepts without comments.
LONGEST = 1000


class Stopped(Exception):
    """The job cannot go on."""


def digits(value, count):
    return "".join(DIGITS[value >> (4 * place) & 15] for place in reversed(range(count)))


def value(letters):
    """Returns the number that letters stand for, or None."""
    number = 0
    for letter in letters:
        place = DIGITS.find(letter)
        if place < 0:
            return None
        number = number << 4 | place
    return number


def new_session():
    """Returns random letters, so that lines sent earlier do not belong to this session."""
    return "".join(random.SystemRandom().choice(LETTERS) for _ in range(4))


def checked(session, number, text):
    """Returns a checked line: number (modulo 4096), length, CRC, text. The CRC also covers session and whole number."""
    length = digits(len(text) % 256, 2)
    check = binascii.crc32((session + digits(number, 8) + length + text).encode("ascii", "replace"))
    return f":{digits(number % NUMBERS, 3)}{length}{digits(check, 8)}{text}"


def line_of(session, number, text):
    """Returns a text as the bytes of a checked line."""
    return (checked(session, number, text.translate(SUBSTITUTES)) + "\n").encode("ascii")


def answer_in(line, session, taken):
    """Returns number and text of an answer; None if the line is damaged or no answer. `taken`: count of lines taken."""
    number, text = value(line[1:4]), line[14:]
    if number is None:
        return None
    number = taken + (number - taken) % NUMBERS
    return (number, text) if line == checked(session, number, text) else None


def text_of(line):
    """Returns a line of a program as it is sent: in capitals, without characters that must not be sent in a line."""
    # The machine drops control characters, so they are not sent.
    line = re.sub("[\x00-\x1f\x7f]", "", re.sub(r"\s", " ", line)).strip()
    if "(" not in line:
        line = line.split(";")[0].replace(" ", "")
    # Realtime commands and non-ASCII characters are legitimate in comments only. Each becomes `@`, which is an error
    # anywhere else: a typographic minus sign, for instance, must not be dropped.
    return "".join(c if c <= "_" and c not in "!?^" else "@" for c in line.upper())


def program(path):
    """Returns the lines to send, each with its number in the file."""
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        texts = [(number, text_of(line)) for number, line in enumerate(file, 1)]
    for number, text in texts:
        if len(text) > LONGEST:
            raise Stopped(f"line {number} has more than {LONGEST} characters")
    return [(number, text) for number, text in texts if text]


class Tcp:
    def __init__(self, address):
        host, _, port = address.rpartition(":")
        if not port.isdecimal():
            raise Stopped(f"{address} is not HOST:PORT")
        self.socket = socket.create_connection((host, int(port)))

    def send(self, data):
        self.socket.sendall(data)

    def receive(self, seconds):
        """Returns the bytes received, after at most `seconds`."""
        if not select.select([self.socket], [], [], seconds)[0]:
            return b""
        data = self.socket.recv(4096)
        if not data:
            raise Stopped("the machine has closed the connection")
        return data


class Serial:
    def __init__(self, path, baud):
        try:
            import termios
            import tty
        except ImportError:
            raise Stopped("a serial port needs Linux or macOS") from None
        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise Stopped(f"this machine knows no {baud} baud")
        # Non-blocking, so that opening does not wait for a modem's carrier.
        self.file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        os.set_blocking(self.file, True)
        if not os.isatty(self.file):
            raise Stopped(f"{path} is no serial port")
        tty.setraw(self.file)
        settings = termios.tcgetattr(self.file)
        settings[4] = settings[5] = speed
        termios.tcsetattr(self.file, termios.TCSANOW, settings)

    def send(self, data):
        while data:
            data = data[os.write(self.file, data) :]

    def receive(self, seconds):
        if not select.select([self.file], [], [], seconds)[0]:
            return b""
        data = os.read(self.file, 4096)
        if not data:
            raise Stopped("the port is gone")
        return data


class Sender:
    """Sends lines, and repeats them from the first one not taken, because the machine takes lines only in order."""

    def __init__(self, link, lines, tell=print, session=None):
        self.link, self.lines, self.tell = link, lines, tell
        self.session = session or new_session()
        # Numbers of lines: `taken` by the machine, `sent` to it, and `furthest`, which is the maximum of `sent`.
        # `sent` goes back when lines are sent again. Then the lines from `sent` to `furthest` can still arrive from
        # the first time.
        self.taken = self.sent = self.furthest = 0
        # Lengths in bytes of the lines that have been sent and not answered, oldest first.
        self.sizes = []
        # True while the sender waits until all sent lines have arrived. Then it sends the lines not taken again.
        self.is_draining = False
        # `questions`: number of unanswered questions. `asked_at`: value of `sent` at the last question. `plain`:
        # number of answers in a row that are plain, not checked.
        self.questions = self.asked_at = self.plain = 0
        # Number of damaged answers since the last good one.
        self.strange = 0
        self.received = b""
        # Times of the last byte received, the last answer, and the last question.
        self.last_heard = time.monotonic()
        self.last_answer = self.last_asked = 0.0
        self.state = ""
        self.counts = {"lines sent again": 0, "answers damaged": 0, "refusals": 0, "questions": 0}

    def run(self):
        self.begin()
        while self.taken < len(self.lines):
            self.fill()
            for line in self.receive():
                self.read(line)
            if time.monotonic() - self.last_answer > PATIENCE:
                self.ask()
        self.end()

    def receive(self):
        data = self.link.receive(PATIENCE / 4)
        now = time.monotonic()
        if data:
            self.last_heard = now
        elif now - self.last_heard > SILENCE:
            raise Stopped(f"the machine has said nothing for {SILENCE:.0f} s")
        *lines, self.received = (self.received + data).split(b"\n")
        return [line.decode("ascii", "replace").strip("\r") for line in lines]

    def rest(self):
        """Waits for the end of the last move, because it is a fault if the host disconnects earlier ($914)."""
        self.state = ""
        while self.state not in ("Idle", "Check", "Sleep"):
            if self.state == "Alarm":
                raise Stopped("the machine has locked itself")
            time.sleep(PATIENCE / 4)
            self.link.send(b"?")
            for line in self.receive():
                # Ignore an `ok`: it may answer a repeated `$LC=OFF`.
                if line != "ok":
                    self.read(line)

    def begin(self):
        """Requests checked lines until the machine expects line 0. An empty line ends any partial line before."""
        for _ in range(20):
            # The `?` is for a machine that holds: it answers no lines, but it reports its state.
            self.link.send(f"\n$LC=ON{self.session}\n?".encode("ascii"))
            until = time.monotonic() + 2 * PATIENCE
            while time.monotonic() < until:
                for line in self.receive():
                    if line.startswith("<"):
                        self.read_other(line)
                    if answer_in(line, self.session, 0) == (0, "ok"):
                        self.last_answer = time.monotonic()
                        return
        raise Stopped("the machine does not check lines: it holds, is no Oxmill, or in the dialect of Grbl ($900)")

    def end(self):
        for _ in range(20):
            self.link.send(b"\n$LC=OFF\n")
            until = time.monotonic() + PATIENCE
            while time.monotonic() < until:
                if "ok" in self.receive():
                    return
        self.tell("the machine may still check lines: $LC=OFF ends that")

    def give_up(self):
        """Ends the checking of lines without waiting for the answer, so that another host can send plain lines."""
        with contextlib.suppress(Stopped, OSError):
            self.link.send(b"\n$LC=OFF\n")

    def fill(self):
        while not self.is_draining and self.sent < len(self.lines):
            line = line_of(self.session, self.sent, self.lines[self.sent][1])
            if self.sizes and sum(self.sizes) + self.questions + len(line) > WINDOW:
                return
            self.link.send(line)
            self.sizes.append(len(line))
            self.sent += 1
            self.furthest = max(self.furthest, self.sent)

    def read(self, line):
        answer = answer_in(line, self.session, self.taken)
        if answer is None:
            return self.read_other(line)
        self.last_answer, self.plain, self.strange = time.monotonic(), 0, 0
        number, text = answer
        more = number - self.taken
        if number > self.furthest:
            raise Stopped(f"the machine wants line {number}, which was not sent")
        self.taken += more
        del self.sizes[:more]
        self.sent = max(self.sent, self.taken)
        if self.taken > self.asked_at:
            # The machine has taken a line sent after the last question, so all questions have been answered.
            self.questions = 0
        if text == "known":
            self.questions = max(0, self.questions - 1)
            # All lines sent before the question have arrived. If the link has doubled a line end, only some of them
            # have.
            if self.is_draining:
                self.counts["lines sent again"] += self.sent - self.taken
                self.is_draining, self.sent, self.sizes = False, self.taken, []
        elif text == "error:129":
            self.counts["refusals"] += 1
            self.drain()
        elif text != "ok":
            number, text_sent = self.lines[max(self.taken, 1) - 1]
            raise Stopped(f"line {number}, `{text_sent}`: {text}")

    def drain(self):
        if not self.is_draining:
            self.is_draining = True
            self.question()

    def ask(self):
        """Sends a question after a while without an answer, because an answer has been lost or the machine is busy."""
        self.last_answer = time.monotonic()
        self.is_draining = True
        self.question()
        self.link.send(b"?")

    def question(self):
        now = time.monotonic()
        if self.questions < QUESTIONS:
            # If nothing has arrived since the last question, the link may be dead. A question that is lost in a dead
            # link takes no room in the machine, so it is not counted.
            self.questions += self.last_heard > self.last_asked
            self.last_asked, self.asked_at = now, self.sent
            self.counts["questions"] += 1
            self.link.send(b"\n")

    def read_other(self, line):
        if line.startswith("ALARM:"):
            raise Stopped(line)
        if line.startswith(("Grbl ", "GrblHAL ")) or "Lines are not checked any more" in line:
            raise Stopped("the machine has been reset or stopped")
        if line.startswith("[MSG:"):
            self.tell(line)
        elif line.startswith(":"):
            self.counts["answers damaged"] += 1
            self.strange += 1
            if self.strange > STRANGE:
                raise Stopped("the machine answers another sender")
        elif line.startswith("<"):
            state = re.split("[|:>]", line[1:])[0]
            if state != self.state and state in ("Hold", "Door", "Alarm", "Sleep"):
                self.tell(f"the machine is in {state}" + (": Enter resumes" if state in ("Hold", "Door") else ""))
            self.state = state
        elif line == "ok" or line.startswith("error:"):
            # A single plain answer can be a checked answer that has lost its beginning.
            self.plain += 1
            if self.plain > 8:
                raise Stopped("the machine does not check lines any more")


def resume_on_enter(link):
    for _ in sys.stdin:
        link.send(b"~")


def main():
    parser = argparse.ArgumentParser(description="Streams a job in checked lines.")
    parser.add_argument("job")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--tcp", metavar="HOST:PORT")
    where.add_argument("--serial", metavar="DEVICE")
    parser.add_argument("--baud", type=int, default=115200)
    options = parser.parse_args()
    begin = time.monotonic()
    sender = Sender(None, [])
    try:
        sender.lines = program(options.job)
        sender.link = Tcp(options.tcp) if options.tcp else Serial(options.serial, options.baud)
        if sys.stdin.isatty():
            threading.Thread(target=resume_on_enter, args=(sender.link,), daemon=True).start()
        sender.run()
        sender.rest()
    except (Stopped, OSError, KeyboardInterrupt) as why:
        if sender.link:
            if isinstance(why, KeyboardInterrupt):
                why = "held: ~ resumes, Ctrl-X resets"
                with contextlib.suppress(OSError):
                    sender.link.send(b"!")
            sender.give_up()
        print(f"{why}; {sender.taken} of {len(sender.lines)} lines taken", file=sys.stderr)
        return 1
    counts = ", ".join(f"{count} {name}" for name, count in sender.counts.items())
    print(f"{len(sender.lines)} lines in {time.monotonic() - begin:.1f} s; {counts}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
