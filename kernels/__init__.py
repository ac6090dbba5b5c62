"""Device code. Installed as ``warpcontact.kernels``.

Kernels import nothing from the host package; the host package imports kernels.
"""

import sys as _sys
from pathlib import Path as _Path

# Imported as plain ``kernels`` from the root of a checkout, every struct would exist twice, and Warp would reject
# one copy where the other is expected.
if __name__ != "warpcontact.kernels":
    raise ImportError(f"import this package as 'warpcontact.kernels', not as {__name__!r}")

# An editable install of one checkout and a working directory in another would mix the two without a message.
_here = _Path(__file__).resolve().parent
_host = _Path(_sys.modules["warpcontact"].__path__[0]).resolve()
if _here not in (_host / "kernels", _host.parent / "kernels"):
    raise ImportError(
        f"warpcontact comes from {_host} and its kernels from {_here}: two checkouts are mixed. "
        "Use one environment per checkout, and install it there: pip install -e ."
    )
