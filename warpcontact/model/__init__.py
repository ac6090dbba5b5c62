"""From a scene to a model: plan, build, parameters, sensors and memory."""
