"""A process that loads mesh files one after the other and reports the result of each; see test_mesh_fuzz.

The argument is the limit on processor time in seconds. Every file is read as by ``load_mesh``, but if the system
supports it, the sandboxed process is a fork of this one that has its imports already. Starting Python takes longer
than loading most files.
"""

import contextlib
import json
import os
import sys

import numpy as np

from warpcontact.meshes import Limits, MeshError, isolation, load_mesh

BUGS = ("the reader process failed", "the reader process answered")


class Fork:
    """Replacement for the ``subprocess.Popen`` used by ``isolation``, without a new Python process."""

    def __init__(self, *_, **__):
        (into, self._in), (self._out, out), (self._errors, errors) = os.pipe(), os.pipe(), os.pipe()
        self.pid, self.code = os.fork(), None
        if not self.pid:
            try:
                for number, end in enumerate((into, out, errors)):
                    os.dup2(end, number)
                os.closerange(3, 256)
                request = json.loads(os.fdopen(0, "rb").read())
                from warpcontact.meshes.reader_process import main

                main(request)
            finally:
                os._exit(1)
        for end in (into, out, errors):
            os.close(end)
        self.stdin, self.stdout, self.stderr = (
            os.fdopen(end, mode) for end, mode in ((self._in, "wb"), (self._out, "rb"), (self._errors, "rb"))
        )

    def kill(self):
        if self.code is None:
            os.kill(self.pid, 9)

    def wait(self):
        if self.code is None:
            self.code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.code

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for pipe in (self.stdin, self.stdout, self.stderr):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
        self.wait()


def verdict(load):
    """Result of loading a mesh: "mesh", "refused", or a description of the error."""
    try:
        mesh = load()
    except MeshError as error:
        text = str(error).strip()
        return next((text for bug in BUGS if bug in text), "refused" if text else "refused without a word")
    except BaseException as error:
        return f"{type(error).__name__}: {error}"
    if not np.isfinite(mesh.vertices).all() or np.abs(mesh.vertices).max() > 1e6:
        return "a mesh with a bad vertex"
    if not len(mesh.faces) or not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
        return "a mesh with a bad index"
    if any(len(members) and members[-1] >= len(mesh.faces) for members in mesh.groups.values()):
        return "a mesh with a bad group"
    return "mesh"


def main():
    limits = Limits(seconds=float(sys.argv[1]))
    if hasattr(os, "fork"):
        import scipy.sparse.csgraph
        import scipy.spatial  # noqa: F401
        from pxr import Sdf, Usd, UsdGeom  # noqa: F401

        isolation.subprocess.Popen = Fork
    print("ready", flush=True)
    for line in sys.stdin:
        path, start = json.loads(line), sum(os.times()[:4])
        answer = verdict(lambda path=path: load_mesh(path, limits=limits))
        print(json.dumps((answer, sum(os.times()[:4]) - start)), flush=True)


if __name__ == "__main__":
    main()
