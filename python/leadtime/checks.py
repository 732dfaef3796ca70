"""What several modules check alike of what they are given."""

import math
import operator
from collections.abc import Iterable, Mapping


def whole(value, what, below=math.inf):
    """Returns a number that names a run or an episode, in whatever type of whole numbers it comes."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < below:
        raise ValueError(f"{what} {value!r}; allowed: a whole number from 0 {'on' if below == math.inf else f'to {below - 1}'}")
    return number


def named(facts):
    """Returns the facts that hold, as a list of their names; None if nothing is said of them."""
    if facts is None:
        return None
    # Of a dict only the keys would be read, whatever it says of them.
    is_many = isinstance(facts, Iterable) and not isinstance(facts, (str, bytes, Mapping))
    names = list(facts) if is_many else None
    if names is None or not all(isinstance(name, str) for name in names):
        raise ValueError(f"facts are a list of names, not {facts!r}")
    return names
