"""How kernels of a step are built: a GPU rounds every product, whatever else has asked for a kernel before."""

from types import SimpleNamespace

import pytest
import warp as wp
from warpcontact.kernels import integrate

from warpcontact.compiling import round_each_product


@pytest.mark.parametrize("threads", [1, 64, 256])
def test_a_gpu_rounds_every_product_and_a_cpu_does_not(threads):
    module = integrate.semi_implicit_euler(wp.float32).module
    gpu, cpu = (SimpleNamespace(is_cuda=is_cuda) for is_cuda in (True, False))
    of_cpu = module.get_module_hash(threads)
    round_each_product(SimpleNamespace(module=module), gpu)
    assert not module.resolve_options(wp.config, threads)["fuse_fp"]
    of_gpu = module.get_module_hash(threads)
    round_each_product(SimpleNamespace(module=module), cpu)
    assert of_gpu != of_cpu == module.get_module_hash(threads)
