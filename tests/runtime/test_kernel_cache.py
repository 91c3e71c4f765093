"""Kernels from elsewhere leave the cache of the package's own alone."""

import numpy as np

from hev_can_emu.jit import JIT_DISABLED, cache_folder, cache_home, kernel


@kernel
def double(x: np.ndarray) -> int:
    for i in range(x.shape[0]):
        x[i] *= 2.0
    return x.shape[0]


def test_a_kernel_of_another_package_is_compiled_but_not_kept() -> None:
    cache_folder("plant.motion")
    before = {path.name for path in cache_home().iterdir()}
    x = np.ones(3)
    assert double(x) == 3
    assert x.tolist() == [2.0, 2.0, 2.0]
    assert {path.name for path in cache_home().iterdir()} >= before
    assert not JIT_DISABLED
    assert not list(cache_home().rglob("*double*"))
