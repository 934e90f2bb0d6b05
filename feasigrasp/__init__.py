"""feasigrasp: feasible grasping of moving objects, as Drake systems.

A run, and how it went::

    import feasigrasp as fg

    result = fg.run(fg.load_scenario("ReachLinear"))
    print(result.held, result.log["X_WO"][-1])

`__init__.pyi` lists the public names; a module is imported when one of its names is used (SPEC 1).
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
