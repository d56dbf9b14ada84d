"""What a cell has printed, in one piece.

A command of a page prints in chunks that end anywhere. myst-nb (1.4) joins them with a
line break between them, and leaves out empty lines where a chunk ends in some.
"""

from typing import Any


def setup(app: Any) -> dict[str, Any]:
    """Of the extension."""
    import myst_nb.core.render as render

    render.coalesce_streams = joined
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def joined(outputs: list[Any]) -> list[Any]:
    """All that was printed to a stream in the place of its first chunk, what went to
    stderr behind everything; outputs that are no streams as they are."""
    texts: dict[str, str] = {}
    for output in outputs:
        if output["output_type"] == "stream":
            text = "".join(output["text"])
            texts[output["name"]] = texts.get(output["name"], "") + text
    out = []
    for output in outputs:
        if output["output_type"] != "stream":
            out.append(output)
        elif output["name"] in texts:
            output["text"] = texts.pop(output["name"]).rstrip() + "\n"
            out.append(output)
    return sorted(out, key=lambda output: output.get("name") == "stderr")
