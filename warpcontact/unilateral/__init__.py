"""Unilateral contact: static problems, equilibrium, and the hard contacts of time stepping."""

from warpcontact.unilateral.diagnosis import Diagnosis
from warpcontact.unilateral.problem import Problem
from warpcontact.unilateral.solution import Solution
from warpcontact.unilateral.solve import solve, solve_delassus

__all__ = ["Diagnosis", "Problem", "Solution", "solve", "solve_delassus"]
