"""The search of `jaxnarx identify`: what it tells, keeps, and lets one take."""
