"""Device arrays: parameters, planned allocation, checkpointed state, memory estimates."""
