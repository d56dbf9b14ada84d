"""What is known of an output before anything is measured."""

from collections.abc import Mapping, Sequence

from jaxnarx.checks import positive, require, require_known
from jaxnarx.formatting import page
from jaxnarx.settings.fields import settings


@settings
class Physics:
    """Signs of the gains of one output at rest, and how slow it is at most.

    The output at rest, all other inputs held, must not fall with inputs of
    `increases_with`, nor rise with those of `decreases_with`, over its whole domain. No
    feedback and no filter of its model has a time constant beyond
    `longest_time_constant`.

    Example:
        known = jnx.identification.Physics(increases_with=["a"], decreases_with=["b"])
        print(known)
    """

    increases_with: Sequence[str] = ()
    """Inputs with which the output at rest rises, or stays."""
    decreases_with: Sequence[str] = ()
    """Inputs with which it falls, or stays."""
    longest_time_constant: float | int | None = None
    """Time constant of its slowest answer at most [s]; None where nothing is known."""

    def __post_init__(self) -> None:
        both = [name for name in self.increases_with if name in self.decreases_with]
        require(
            not both,
            "increases_with",
            f"increases_with and decreases_with contradict each other: "
            f"{', '.join(both)} is in both; a gain has one sign",
        )
        longest = self.longest_time_constant
        require(
            bool(self.signs) or longest is not None,
            "increases_with",
            "physics without an input says nothing; name one under increases_with or "
            "decreases_with, or give a longest_time_constant",
        )
        if longest is not None:
            seconds = positive(longest, "longest_time_constant", "number of seconds")
            object.__setattr__(self, "longest_time_constant", seconds)

    @property
    def signs(self) -> dict[str, int]:
        """One of every input with which the output rises, minus one where it falls."""
        return dict.fromkeys(self.increases_with, 1) | dict.fromkeys(
            self.decreases_with, -1
        )

    _repr_html_ = page

    def __str__(self) -> str:
        """`rises with a, b and falls with c, no slower than 20 s`."""
        ways = ("rises", self.increases_with), ("falls", self.decreases_with)
        told = " and ".join(
            f"{w} with {', '.join(names)}" for w, names in ways if names
        )
        if self.longest_time_constant is None:
            return told
        slowest = f"no slower than {self.longest_time_constant:g} s"
        return f"{told}, {slowest}" if told else f"is {slowest}"


def require_physics(
    physics: Mapping[str, Physics], inputs: Sequence[str], outputs: Sequence[str]
) -> None:
    """SpecError where physics names a channel that there is not."""
    for output, own in physics.items():
        require_known(
            output, outputs, "physics", f"physics: there is no output {output!r}"
        )
        for name in own.signs:
            told = f"physics of {output}: there is no input {name!r}"
            require_known(name, inputs, f"physics.{output}", told)
