"""From a start to a solution: the encoded image and the objective of a level, and the levels from coarse to fine."""
