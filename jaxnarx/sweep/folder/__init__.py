"""The folder of a sweep: what it is, which chunks are done, who works on which."""
