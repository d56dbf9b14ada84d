"""Figures: plain data in, a `Picture` out, or a matplotlib figure where only `jnx.plot`
draws it. `svg` and `draw` draw pictures."""
