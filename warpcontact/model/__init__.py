"""From the data of a scene to a model on a device: plan, parameters, sensors and health."""
