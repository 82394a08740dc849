"""The core's fit of a level in NumPy, which defines its results, and the thresholds that both share."""
