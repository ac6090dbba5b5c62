"""USD in: a scene from a stage, one of ours to the bit, one of others as far as UsdPhysics describes it.

What reads files runs in a process of its own, and imports neither Warp nor the rest of the library: ``stage``,
``records``, ``physics`` and ``colliders``. What makes a scene of what they found runs here: ``restore`` for a
stage of ours, ``assemble`` for others.
"""
