"""USD import: builds a scene from a stage.

A stage exported by warpcontact gives a bitwise identical scene; other stages are read as far as UsdPhysics describes
them. ``stage``, ``physics``, ``prims``, ``properties`` and ``findings`` read files in a sandboxed process and import
neither Warp nor the rest of the library. The scene is built in the main process: by ``restore`` from a description, by
``scene_from_stage`` from UsdPhysics.
"""
