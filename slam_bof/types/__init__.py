"""Data types passed between the stages of the pipeline. All are frozen.

Poses are 4x4 float64 matrices named ``T_a_b``: ``p_a = T_a_b @ p_b``. Camera
frames are x right, y down, z forward. Metres, radians and seconds.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
