"""A synthetic world: furnished rooms, a flat with a tour, and a depth-sensor model.

Open3D, which casts the rays, is imported when the first ``Scene3D`` is made.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
