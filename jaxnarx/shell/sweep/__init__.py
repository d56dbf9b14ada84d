"""`jaxnarx sweep`: its description, its engines, its run, its table."""
