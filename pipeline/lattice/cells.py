"""Cell codes of the lattice, int8, shared by the stress and the flow kernels.

- ``VOID``: a parked void inside the movement zone (bulking porosity or a hang-up).
- ``STAGNANT``, ``MOVEMENT``: granular cells, in undisturbed and in loosened ground.
- ``OUTSIDE``: not ground, never filled and never crossed.
- ``AIR``: void open to the surface: above the fill from the start, or subsided ground.

The state and zone flags that files hold derive from these codes.
"""

import numpy as np

VOID = np.int8(0)
STAGNANT = np.int8(1)
MOVEMENT = np.int8(2)
OUTSIDE = np.int8(3)
AIR = np.int8(4)
