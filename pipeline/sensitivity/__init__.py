"""How readings answer to parameters, effects and single cells."""
