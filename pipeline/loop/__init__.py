"""The closed loop: residual → missing effect → model → error before and after.

A round reads like its steps: `model` simulates what the readings should be, `covariance` says how
far they may be off, `fit` calibrates, `certificate` says what can be told apart, `gate` whether
anything is missing, `attribution` what; `close` repeats them and scores. Measured values enter in
`data` alone, and held-out ones never do.
"""

SURE = 0.9  # posterior from which one name stands for all
