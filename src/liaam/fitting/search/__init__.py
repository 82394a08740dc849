"""Where a fit starts: given starts, the search for the object, and further places and shapes after a poor fit."""
