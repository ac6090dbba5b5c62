"""Nonsmooth contact: impulses by Signorini's condition and Coulomb's friction cone."""
