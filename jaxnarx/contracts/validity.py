"""The contract of a validity function.

`VALIDITIES.register(name, kind, example=make)`: `make()` returns an instance and the
number of its scheduling variables. Points are columns of scaled variables.
"""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.contracts.life import lives, plant, pool
from jaxnarx.models import VALIDITIES, AbstractValidity, count_models
from jaxnarx.partition import grow
from jaxnarx.settings import Given

_weights = eqx.filter_jit(lambda f, z, active: f(z, active))


def weights_sum_to_one(validity: AbstractValidity, dims: int) -> None:
    """Weights are not negative and sum to one, in the range and far beyond it; of a
    class that says they do not (`sums_to_one`) each is from zero to one.

    This is the property that `is_convex` claims.
    """
    models = count_models(validity, dims)
    for distance in (1.0, 1e3, 1e100):
        z = distance * np.random.default_rng(0).uniform(-1.5, 2.5, size=(dims, 500))
        phi = _phi(validity, z, np.ones(models, bool))
        assert phi.shape == (models, 500)
        if validity.sums_to_one:
            np.testing.assert_allclose(phi.sum(axis=0), 1.0, rtol=0, atol=1e-12)
        assert np.all(phi <= 1 + 1e-12)
        # A difference of sigmoids rounds to a few last digits below zero at worst.
        assert np.all(phi >= -1e-15)


def inactive_models_weigh_nothing(validity: AbstractValidity, dims: int) -> None:
    """A model that is not active has weight zero, and the others share the rest."""
    models = count_models(validity, dims)
    if models == 1:
        return
    z = np.random.default_rng(1).uniform(-0.2, 1.2, size=(dims, 300))
    phi = _phi(validity, z, np.arange(models) < models - 1)
    np.testing.assert_array_equal(phi[-1], 0.0)
    if validity.sums_to_one:
        np.testing.assert_allclose(phi.sum(axis=0), 1.0, rtol=0, atol=1e-12)


def samples_do_not_know_one_another(validity: AbstractValidity, dims: int) -> None:
    """One point alone has the weights that it has among many."""
    models = count_models(validity, dims)
    z = np.random.default_rng(2).uniform(size=(dims, 5))
    many = _phi(validity, z, np.ones(models, bool))
    for n in range(5):
        one = _weights(validity, jnp.asarray(z[:, n]), jnp.ones(models, bool))
        np.testing.assert_allclose(one, many[:, n], rtol=1e-13, atol=1e-15)


def derivatives_are_central_differences(validity: AbstractValidity, dims: int) -> None:
    """Derivatives by the trained fields and by the place; piecewise constant ones have
    zeros."""
    if not validity.trained:
        return
    models, rng = count_models(validity, dims), np.random.default_rng(4)
    z = jnp.asarray(rng.uniform(size=(dims, 40)))
    share = jnp.asarray(rng.normal(size=(models, 40)))

    def value(parameters, z):
        phi = validity.replace_parameters(parameters)(z, jnp.ones(models, bool))
        return jnp.sum(phi * share)

    compiled = jax.jit(value)
    found = jax.jit(jax.grad(value, argnums=(0, 1)))(validity.parameters, z)
    leaves, tree = jax.tree.flatten((validity.parameters, z))
    flat = np.concatenate([np.ravel(leaf) for leaf in leaves])
    ends = np.cumsum([leaf.size for leaf in leaves])[:-1]

    def evaluate(x):
        parts = zip(np.split(x, ends), leaves, strict=True)
        new = [jnp.asarray(p.reshape(q.shape)) for p, q in parts]
        return float(compiled(*jax.tree.unflatten(tree, new)))

    h, eye = 1e-6, np.eye(len(flat))
    expected = [
        (evaluate(flat + h * e) - evaluate(flat - h * e)) / (2 * h) for e in eye
    ]
    ours = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(found)])
    # h^2 of the third derivative and 1e-16/h of rounding.
    np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-6)


def limits_enclose_the_present(validity: AbstractValidity, dims: int) -> None:
    """`limits` gives a lower and an upper value of every trained field around it."""
    low, high = validity.limits((0.5, 2.0))
    for name in validity.trained:
        trees = low, validity, high
        least, here, most = (np.asarray(getattr(v, name)) for v in trees)
        assert least.shape == here.shape == most.shape, name
        assert np.all(least <= here) and np.all(here <= most), name


def check_refuses_other_sizes(validity: AbstractValidity, dims: int) -> None:
    """A file whose arrays do not fit is refused by a ValueError of `check`."""
    models = count_models(validity, dims)
    validity.check(models, dims)
    try:
        validity.check(models + 1, dims)
    except ValueError:
        return
    raise AssertionError("`check` accepts a local model too many")


def regions_are_told(validity: AbstractValidity, dims: int) -> None:
    """`regions` says something of every local model, with the names it is given."""
    names = [f"x{n}[t]" for n in range(dims)]
    found = validity.regions(names, np.zeros(dims), np.ones(dims))
    assert len(found) == count_models(validity, dims)
    assert all(isinstance(region, dict) for region in found)


def lives_with_it(validity: AbstractValidity, dims: int, folder: Path) -> None:
    """A network with it is refined, saved, loaded and exported, or says it cannot."""
    kind = type(validity)
    assert VALIDITIES.get(kind.__name__) is kind, "it is not registered under its name"
    given = Given(validity, scheduling=["u[t-1]", "v[t-1]", "y[t-1]", "u[t-2]"][:dims])
    lives(grow(pool(), plant(), given).value, folder)


CHECKS_WITHOUT_NETWORK = (
    weights_sum_to_one,
    inactive_models_weigh_nothing,
    samples_do_not_know_one_another,
    derivatives_are_central_differences,
    limits_enclose_the_present,
    check_refuses_other_sizes,
    regions_are_told,
)
"""Checks that need no network."""
CHECKS = (*CHECKS_WITHOUT_NETWORK, lives_with_it)


def _phi(
    validity: AbstractValidity,
    z: Float[np.ndarray, "dims points"],
    active: Bool[np.ndarray, " models"],
) -> Float[np.ndarray, "models points"]:
    return np.asarray(_weights(validity, jnp.asarray(z), jnp.asarray(active)))
