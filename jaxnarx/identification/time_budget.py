"""How outputs share the time of a search."""

import statistics


class TimeBudget:
    """Outputs begin one after the other, as many at a time as there are workers."""

    def __init__(self, until: float, outputs: int, workers: int):
        """`until` is the time of the clock [s] at which all are to be done."""
        self.until, self.waiting, self.workers = until, outputs, workers
        self.begun: dict[str, float] = {}
        self.took: list[float] = []

    def begin(self, output: str, now: float) -> float:
        """Until when an output that begins now may take; the last may use all that is
        left."""
        rounds = -(-self.waiting // self.workers)
        self.begun[output] = now
        self.waiting -= 1
        return now + (self.until - now) / rounds

    def finish(self, output: str, now: float) -> None:
        """An output is complete."""
        self.took.append(now - self.begun.pop(output))

    def seconds_left(self, now: float) -> float | None:
        """Seconds until all is done, by what outputs took so far; None before one is
        complete."""
        if not self.took:
            return None
        usual = statistics.fmean(self.took)
        running = sum(max(usual - (now - begin), 0.0) for begin in self.begun.values())
        return (running + usual * self.waiting) / self.workers
