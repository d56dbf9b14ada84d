"""Fixtures of the command line's tests."""

import jax
import pytest
from jax.experimental.compilation_cache import compilation_cache


@pytest.fixture(scope="module")
def own_settings(tmp_path_factory):
    """Compiled programs go to a folder of this module; jax is left as it was."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("JAXNARX_DATA", raising=False)
        yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


@pytest.fixture(scope="module")
def described(own_settings, tmp_path_factory):
    """Makes the working folder: a file a part by `write(path, seed)`, and engine.toml.

    Columns are speed, load and temp at 0.1 s.
    """
    del own_settings
    with pytest.MonkeyPatch.context() as patch:

        def make(write):
            folder = tmp_path_factory.mktemp("engine")
            for k in range(3):
                write(folder / f"r{k}.csv", k)
            lines = ["[data]", "sample_time = 0.1", "[channels.inputs]"]
            lines += ['speed = "rpm"', 'load = "%"']
            lines += ["[channels.outputs]", 'temp = "degC"', "[records]"]
            parts = {"train": 0, "validate": 1, "test": 2}
            lines += [f'{part} = ["r{k}.csv"]' for part, k in parts.items()]
            (folder / "engine.toml").write_text("\n".join(lines))
            patch.chdir(folder)
            return folder

        yield make
