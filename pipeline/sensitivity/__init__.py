"""How readings answer to parameters, effects and single cells."""

FOOTPRINT_REPLICATES = 8  # that a load cell's footprint is the mean of
