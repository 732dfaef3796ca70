"""When and what to say to a listener who reacts late: Leadtime's worlds and policies in Python.

* ``leadtime.gym``: the worlds as Gymnasium environments (needs the package ``gymnasium``)
* ``leadtime.policy``: policies of Leadtime in numpy
* ``leadtime.notifier``: a notifier at work in this process, in numpy
* ``leadtime.worker``: a Gymnasium environment of your own in a run (needs ``gymnasium``)
* ``leadtime.live``: what a notifier at work says to your robot (needs ``eclipse-zenoh``)
* ``leadtime.export``: policies as ONNX (needs ``onnx``)
"""

from leadtime._native import World, Worlds, __version__, configurations

__all__ = ["World", "Worlds", "__version__", "configurations"]
