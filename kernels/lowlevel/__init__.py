"""Code that addresses the compiler: strides, SIMD, vector loads, warp intrinsics."""
