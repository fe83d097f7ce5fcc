"""Places and parts of the cross-validation, as `train-exposure` has them."""

import re

PARTS = 6


def place(name):
    """As `training::place`: files whose names differ in a number at the end, or in `_puresky`, show one place."""
    name = re.sub("_puresky$", "", name)
    return re.sub(r"_*\d+$", "", name)


def places_of(names):
    """The number of the place of each name; its part is that number modulo PARTS."""
    places = sorted({place(name) for name in names})
    return [places.index(place(name)) for name in names]
