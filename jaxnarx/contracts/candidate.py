"""The contract of a candidate of `identify`, `CANDIDATES.register(name, function)`."""

import pickle
from pathlib import Path

from jaxnarx.contracts.life import lives, plant
from jaxnarx.data import groups
from jaxnarx.identification import CandidateFactory, CandidateSearch, run_method
from jaxnarx.partition import profile_data
from jaxnarx.settings import Identification, Preset

QUICK_PRESET = Preset(
    "of contracts", max_models=1, grown=0, fed_back=0, states=0, linear=True
)


def names_methods(candidate: CandidateFactory) -> None:
    """It makes names, each once, and methods of data and an output; each method ends
    with a model of this output."""
    found = list(candidate(plant(), "y"))
    assert found, "it has no candidate for two inputs and one output"
    names = [name for name, _ in found]
    assert len(set(names)) == len(names)
    assert all(isinstance(method, Identification) for _, method in found)


def goes_to_another_process(candidate: CandidateFactory) -> None:
    """It can be pickled: outputs are searched side by side. A function of a module can,
    one inside of another function, or of a notebook, cannot."""
    assert pickle.loads(pickle.dumps(candidate)) is candidate


def is_tried_in_a_search(candidate: CandidateFactory) -> None:
    """It becomes a row of a leaderboard, with an error on records left out."""
    data = plant()
    search = CandidateSearch(
        *(data, profile_data(data, "y"), groups(data), QUICK_PRESET),
        added={"added": candidate},
    )
    rows = [row for row, _ in search if row.family == "added"]
    assert rows, "it was not tried"
    told = "; ".join(f"{row.name}: {row.status} {row.detail}" for row in rows)
    assert any(row.eligible for row in rows), told


def lives_with_it(candidate: CandidateFactory, folder: Path) -> None:
    """The network of its first method is refined, saved, loaded and exported, or says
    that it cannot be."""
    _, method = next(iter(candidate(plant(), "y")))
    found = run_method(plant(), method, None, None)
    assert found.is_okay, found.detail
    lives(found.value, folder)


CHECKS = (names_methods, goes_to_another_process, is_tried_in_a_search, lives_with_it)
