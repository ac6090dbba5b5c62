"""Camera, lights and display material of a stage, so that any viewer shows it without setup."""

import math
from typing import Any

import numpy as np

from warpcontact.validation.checks import Array

# Direction from the scene to the camera, and margin around the scene.
_FROM = np.array([0.55, -0.75, 0.42])
_MARGIN = 1.15
# 36 mm film. The unit (0.1 mm if the stage is in cm) does not matter: only ratios are used.
_FILM = (36.0, 20.25)
_FOCAL = 35.0


def define_camera(stage: Any, path: str, low: Array, high: Array) -> None:
    """Writes a camera with the box between two corners (3,) [m] in view."""
    from pxr import Gf, UsdGeom

    center, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1.0e-3)
    # The bounding sphere of the box must fit into the smaller (vertical) angle of view.
    half_angle = math.atan(0.5 * _FILM[1] / _FOCAL)
    distance = _MARGIN * radius / math.sin(half_angle)
    back = _FROM / np.linalg.norm(_FROM)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    rows = [[*right, 0.0], [*up, 0.0], [*back, 0.0], [*(center + distance * back), 1.0]]
    camera = UsdGeom.Camera.Define(stage, path)
    camera.AddTransformOp().Set(Gf.Matrix4d(*np.array(rows).reshape(-1).tolist()))
    camera.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    camera.CreateHorizontalApertureAttr(_FILM[0])
    camera.CreateVerticalApertureAttr(_FILM[1])
    camera.CreateFocalLengthAttr(_FOCAL)
    camera.CreateFocusDistanceAttr(distance)
    near = max(0.01 * distance, distance - 20.0 * radius)
    camera.CreateClippingRangeAttr(Gf.Vec2f(near, distance + 100.0 * radius))
    camera.GetPrim().SetDocumentation("All bodies of the environments are in view at all times.")


def define_lights(stage: Any, path: str) -> None:
    """Writes a distant light (sun) and a dome light (sky)."""
    from pxr import Gf, UsdGeom, UsdLux

    UsdGeom.Scope.Define(stage, path)
    sun = UsdLux.DistantLight.Define(stage, f"{path}/Sun")
    # The small angle gives about daylight, for a camera with white at 1.
    sun.CreateIntensityAttr(35000.0)
    sun.CreateAngleAttr(0.53)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(40.0, 25.0, 0.0))
    sky = UsdLux.DomeLight.Define(stage, f"{path}/Sky")
    sky.CreateIntensityAttr(0.35)


def define_display_material(stage: Any, scope: str, prim: Any) -> None:
    """Writes a material that shows ``displayColor`` into ``scope`` and binds it to ``prim`` and its descendants.

    Most renderers other than Hydra's built-in one ignore ``displayColor`` without a material.
    """
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, scope)
    path = f"{scope}/Display"
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.6)
    reader = UsdShade.Shader.Define(stage, f"{path}/Color")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    output = reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(output)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
