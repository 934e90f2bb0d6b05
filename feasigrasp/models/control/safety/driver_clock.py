"""Counts the control cycles of an arm's driver, by its stamps and by this computer's clock.

A driver in position mode takes one command in each of its cycles, and holds it for one cycle. One
step of the commanded position per cycle therefore has the velocity that it is meant to have. A step
per message has not: messages are lost, doubled, overtaken or forged, and clocks are set.
"""

import statistics
from collections import deque
from enum import Enum, auto

#: Periods of drivers that are served [s]. Source: data sheet: FRI has 1 to 10 ms.
SHORTEST, LONGEST = 0.9e-3, 10.5e-3
#: How far a stamp may be from the instant at which the next cycle is due [periods], and an interval
#: shorter or longer than the usual one [usual intervals]: what comes sooner is of no cycle, what
#: comes later leaves cycles out, if its stamp says so too, and a clock that is faster is not this
#: computer's. Source: reasoned: a lost message makes 1.
JITTER = 0.75
#: A message that comes sooner after the last than this is one of a burst [periods].
#: Source: reasoned: a driver that gets two commands in one cycle takes the second.
BURST = 0.3
#: A message that comes later after the last than this leaves cycles out where stamps show that the
#: clock was set [usual intervals]. Source: reasoned: a busy computer is late as well.
LATE_AT_STEP = 4.0
#: A status is missing where none has come for the first of these, and the driver takes a command
#: for its cycle until the second [cycles]. Source: reasoned: its next cycle begins at 2.
MISSING, IN_TIME = 1.5, 1.8
#: Cycles are counted without statuses where both clocks were compared over this time [s], and
#: differ by this share at most. Source: reasoned: they are in step until the arm has braked.
COMPARED, AGREE = 0.5, 0.02
#: A clock that comes to be faster than this computer's by more than this ratio is followed slowly,
#: by the average over this number of cycles. Source: guessed.
FASTER, AVERAGED = 0.5, 200


class Tick(Enum):
    """What a status message means for the commands."""

    #: No cycle: a copy, one that was overtaken, or one that came too soon.
    NONE = auto()
    #: The next cycle.
    NEXT = auto()
    #: The next cycle, and the driver's clock was set.
    STEPPED = auto()
    #: Cycles passed without a command: the driver has held its position.
    GAP = auto()
    #: The first message, or the first after a silence.
    BEGIN = auto()


class DriverClock:
    """The cycle count of a driver.

    Attributes:
        period: Of the driver [s].
        passed: How much driver's time the last message ended [s]; a clock that was set is not that.
        rate: Time by this computer's clock in a unit of the driver's, at most 1.
    """

    def __init__(self, period: float, silence: float) -> None:
        """A clock of a period until `measure`; after a silence another driver may begin [s]."""
        self.period, self.passed, self.rate = period, 0.0, 1.0
        self._silence = silence
        self._stamp = self._due = self._now = self._on_time = float("nan")
        self._stamps: list[float] | None = []
        self._intervals: deque[float] = deque(maxlen=9)
        self._average, self._skipped = 1.0, False
        #: Stamp and clock at the message that cycles are compared from, and the ratio since [s].
        self._reference, self._ratio = (0.0, 0.0), float("nan")
        #: Cycles of which the status is missing, since the last message that was used.
        self.missing = 0

    @property
    def interval(self) -> float:
        """Usual time between messages by this computer's clock [s]."""
        return statistics.median(self._intervals) if self._intervals else self.period

    @property
    def due(self) -> float:
        """When the next message is due by this computer's clock [s]; NaN if that is unknown."""
        return self._on_time + self._ratio * self.period

    @property
    def shortest(self) -> float:
        """Shortest cycle of late by this computer's clock [s]."""
        return max(min(self._intervals, default=0.0), JITTER * self.period)

    def tick(self, stamp: float, now: float) -> Tick:
        """What a status message with a stamp [s] means; ``now`` is this computer's clock [s]."""
        passed, late = stamp - self._stamp, now - self._now
        self.passed = 0.0
        if passed == 0.0:
            return Tick.NONE
        if not late <= self._silence and not 0.0 < passed <= self._silence:
            return self._begin(stamp, now)
        if self._stamps is not None:
            return self._first(stamp, late, now)
        error = stamp - self._due
        in_turn = abs(error) <= JITTER * self.period
        if self.missing and not in_turn and late < IN_TIME * self._ratio * self.period:
            return Tick.NONE  # its cycle was counted, or the clock was set meanwhile
        usual = self.interval
        too_soon = not in_turn or error < (JITTER - 1.0) * self.period
        if too_soon and late < JITTER * usual:
            return Tick.NONE
        self._now = now
        self._intervals.append(late)
        if late < BURST * self.period:
            self._skipped, self.passed = True, self.period
            self._stamp, self._due = stamp, (self._due if in_turn else stamp) + self.period
            return Tick.NONE
        self._average += (min(late / self.period, 2.0) - self._average) / AVERAGED
        self.rate = min(1.0, self._average / FASTER)
        stepped = not 0.0 < passed <= 2.0 * late + self.period
        most = LATE_AT_STEP if stepped else 1.0 + JITTER
        left_out = not in_turn and late > most * usual
        gap, self._skipped = left_out or self._skipped, False
        self._compare(stamp, now, again=not (gap or in_turn))
        self.passed = max(passed, self.period) if gap else self.period
        self._stamp, self.missing = stamp, 0
        late = now - self.due
        # When it was sent: a message that is late moves that a little.
        self._on_time = now - (0.9 * late if in_turn and late > 0.0 else 0.0)
        # The next instant makes up for half of the error.
        self._due = (self._due + 0.5 * error if in_turn else stamp) + self.period
        return Tick.GAP if gap else Tick.NEXT if in_turn else Tick.STEPPED

    def is_missing(self, now: float) -> bool:
        """Whether the status of a cycle is missing; then it is counted, without one."""
        if self._stamps is not None or not abs(self._ratio - 1.0) <= AGREE:
            return False
        cycle = self._ratio * self.period
        if not MISSING * cycle <= now - self._on_time < IN_TIME * cycle:
            return False
        self.missing += 1
        self._now += cycle
        self._on_time += cycle
        self._stamp += self.period
        self._due += self.period
        self.passed = self.period
        return True

    def _compare(self, stamp: float, now: float, *, again: bool) -> None:
        """Compares the clocks; ``again`` where the driver's was set."""
        if again:
            self._reference, self._ratio = (stamp, now), float("nan")
        elif stamp - self._reference[0] >= COMPARED:
            self._ratio = (now - self._reference[1]) / (stamp - self._reference[0])

    def measure(self) -> str:
        """Sets the period to that of the messages since `Tick.BEGIN`.

        Returns why such a driver is not served; nothing, "", if it is.
        """
        assert self._stamps is not None
        self.period = round(statistics.median(self._stamps), 6)
        self._stamps = None
        self._due = self._stamp + self.period
        interval = self.interval
        if not SHORTEST <= self.period <= LONGEST:
            return f"has a period of {1e3 * self.period:.3g} ms; set the driver to 1 to 10 ms"
        if interval < JITTER * self.period:
            return (
                f"has stamps {1e3 * self.period:.3g} ms apart, but comes every "
                f"{1e3 * interval:.3g} ms; stamp it with the time in us"
            )
        return ""

    def _begin(self, stamp: float, now: float) -> Tick:
        self._stamp, self._stamps, self._now = stamp, [], now
        self._intervals.clear()
        self._average, self._skipped, self.missing = 1.0, False, 0
        self._compare(stamp, now, again=True)
        return Tick.BEGIN

    def _first(self, stamp: float, late: float, now: float) -> Tick:
        """Of the messages that the period is measured with."""
        assert self._stamps is not None
        self.passed = max(0.0, min(stamp - self._stamp, late))
        if stamp > self._stamp:
            self._stamps.append(stamp - self._stamp)
        self._stamp, self._now = stamp, now
        self._intervals.append(late)
        return Tick.NEXT
