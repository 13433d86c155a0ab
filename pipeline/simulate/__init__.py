"""One replicate of an experiment: the interface that everything above the lattice leans on.

`setup` and `readings` compile nothing: a job that only reads results imports them and not Numba.
"""
