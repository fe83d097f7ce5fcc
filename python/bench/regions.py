"""The regions of a view, by rule. NumPy only."""
import numpy as np

from pictures import display

# Smallest change of a display value that belongs to a region.
CHANGE = 0.02


def changed(a, b):
    """Pixels where a display value differs by more than `CHANGE`, and so it does in at least 3 of the 8 neighbours.

    The second condition removes single noisy pixels."""
    over = (np.abs(display(a) - display(b)).max(-1) > CHANGE).astype(int)
    padded = np.pad(over, 1)
    h, w = over.shape
    around = sum(padded[j:j + h, i:i + w] for j in range(3) for i in range(3)) - over
    return (over > 0) & (around >= 3)


def regions(without, with_, alpha, unreflected=None):
    """Masks `shadow` and `reflection` (bool). `unreflected`: the picture with the object hidden from glossy rays."""
    outside = alpha <= 0
    any_change = changed(with_, without) & outside
    if unreflected is None:
        return any_change, np.zeros_like(any_change)
    reflection = changed(with_, unreflected) & outside
    return any_change & ~reflection, reflection
