"""When and what to say to a person who reacts late: Leadtime's worlds and policies in Python.

* ``leadtime.gym``: the worlds as Gymnasium environments (needs the package ``gymnasium``)
* ``leadtime.policy``: policies of Leadtime in numpy
"""

from leadtime._native import World, Worlds, __version__, configurations

__all__ = ["World", "Worlds", "__version__", "configurations"]
