"""What is known of an output before anything is measured."""

from collections.abc import Mapping, Sequence

from jaxnarx.checks import require, require_known
from jaxnarx.formatting import page
from jaxnarx.settings.fields import settings


@settings
class Physics:
    """Signs of the gains of one output at rest, over its whole domain.

    The output at rest, all other inputs held, must not fall with inputs of
    `increases_with`, nor rise with those of `decreases_with`.

    Example:
        known = jnx.identification.Physics(increases_with=["a"], decreases_with=["b"])
        print(known)
    """

    increases_with: Sequence[str] = ()
    """Inputs with which the output at rest rises, or stays."""
    decreases_with: Sequence[str] = ()
    """Inputs with which it falls, or stays."""

    def __post_init__(self) -> None:
        both = [name for name in self.increases_with if name in self.decreases_with]
        require(
            not both,
            "increases_with",
            f"increases_with and decreases_with contradict each other: "
            f"{', '.join(both)} is in both; a gain has one sign",
        )
        require(
            bool(self.signs),
            "increases_with",
            "physics without an input says nothing; name one under increases_with or "
            "decreases_with",
        )

    @property
    def signs(self) -> dict[str, int]:
        """One of every input with which the output rises, minus one where it falls."""
        return dict.fromkeys(self.increases_with, 1) | dict.fromkeys(
            self.decreases_with, -1
        )

    _repr_html_ = page

    def __str__(self) -> str:
        """`rises with a, b and falls with c`."""
        ways = ("rises", self.increases_with), ("falls", self.decreases_with)
        return " and ".join(
            f"{w} with {', '.join(names)}" for w, names in ways if names
        )


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
