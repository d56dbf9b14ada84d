"""A whole identification: by a search, or by one settings tree."""

from jaxnarx.docstrings import document
from jaxnarx.identification._by_method import Events, drop_unneeded
from jaxnarx.identification._by_method import run_method as run_method
from jaxnarx.identification.candidates import CANDIDATES, CandidateFactory
from jaxnarx.identification.candidates import CandidateSearch as CandidateSearch
from jaxnarx.identification.explain import (
    candidate_in_use,
    describe,
    figure,
    sentences,
    title,
)
from jaxnarx.identification.leaderboard import Candidate, Leaderboard
from jaxnarx.identification.pools import joint_pool, make_pool, terms_of
from jaxnarx.identification.search_folder import CANDIDATES_FOLDER as CANDIDATES_FOLDER
from jaxnarx.identification.search_folder import SEARCH_FILE as SEARCH_FILE
from jaxnarx.identification.search_folder import SearchFolder, read_search
from jaxnarx.identification.verb import VALIDATION_GROUP, identify, with_group
from jaxnarx.settings import Physics as Physics

__all__ = [
    "CANDIDATES",
    "Candidate",
    "CandidateFactory",
    "Events",
    "Leaderboard",
    "Physics",
    "SearchFolder",
    "VALIDATION_GROUP",
    "describe",
    "figure",
    "identify",
    "joint_pool",
    "make_pool",
    "drop_unneeded",
    "read_search",
    "sentences",
    "terms_of",
    "title",
    "candidate_in_use",
    "with_group",
]

document(Physics)
