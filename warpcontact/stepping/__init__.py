"""Time stepping: simulation, execution plan, worker pool, recorder, checkpoints."""
