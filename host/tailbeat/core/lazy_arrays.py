"""numpy and the array types for modules that connected commands load: numpy itself is loaded when
it is first used, which takes as long as all else that ``tailbeat info`` does.

``from tailbeat.core.lazy_arrays import F32, np`` in place of ``import numpy as np``. At run time
the types are ``Any``: a module whose annotations are looked at then (core.decode) takes
core.arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tailbeat.core.extras import lazy

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike as ArrayLike
    from numpy.typing import NDArray as NDArray

    from tailbeat.core.arrays import F32 as F32
    from tailbeat.core.arrays import F64 as F64
else:
    np = lazy("numpy")
    ArrayLike = NDArray = F32 = F64 = Any

__all__ = ["F32", "F64", "ArrayLike", "NDArray", "np"]
