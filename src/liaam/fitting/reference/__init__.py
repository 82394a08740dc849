"""The core's fit of a level in NumPy: it defines the results of the core, and replaces it where it could not be built.

Two comparisons of the experiments are only here: the joint elimination of the appearance (``elimination="joint"``), and
photometric normalisation (``grey-norm``). The loop also is that of :mod:`liaam.registration`, whose warps have no mesh.
"""
