"""Fixtures of the command line's tests."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def no_data_folder():
    """Files stand beside their descriptions, whatever the user has set."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("JAXNARX_DATA", raising=False)
        yield


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    """Makes the working folder: a file a part by `write(path, seed)`, and engine.toml.

    Columns are speed, load and temp at 0.1 s.
    """
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
