"""Unilateral contact: Signorini's condition and Coulomb's cone, solved for impulses and forces."""
