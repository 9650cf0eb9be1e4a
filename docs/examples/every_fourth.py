from mast_zenoh.links import Rule
from mast_zenoh.scenario import load


class EveryNth(Rule):
    """Loses every n-th message, with a probability.

    n: 2 loses every other message;  probability: that it is lost then
    """

    fate = "dropped"

    def __init__(self, n: int = 4, probability: float = 1.0, at: float = 0.0, until: float | None = None) -> None:
        super().__init__(at, until)
        if n < 1:
            raise ValueError(f"n: found {n}, expected 1 or more")
        self.n = n
        self.probability = probability
        self.count = 0

    def sample(self, rng, count):
        return rng.random((count, 1))

    def apply(self, passage, row):
        self.count += 1
        return () if self.count % self.n == 0 and row[0] < self.probability else (passage,)


def scenario(n=4):
    _, base = load("baseline")
    return base | dict(name="every_fourth", links={"*": dict(up=[dict(type="EveryNth", n=n)])})
