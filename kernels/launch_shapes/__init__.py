"""Fused kernels: stages of a step composed into one launch, bitwise equal to the staged kernels."""
