"""Command line, figures, HTML report. Heavy imports live inside functions."""
