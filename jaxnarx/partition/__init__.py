"""How the operating space is divided among local models."""

from jaxnarx.partition.grow import grow

__all__ = ["grow"]
