"""Stages of several files: layers next to the file are read, layers elsewhere only if trusted."""

import os
import re
import zipfile

import pytest
from pxr import Gf, Sdf, Usd, UsdUtils, Vt
from test_meshes import TETRAHEDRON
from usd_mesh_stages import add_mesh, new_stage, save, save_tetrahedron

from warpcontact.meshes import MeshError, load_mesh
from warpcontact.meshes.readers import Unreadable
from warpcontact.meshes.readers.usd_layers import check_layers


@pytest.fixture
def tetrahedron(tmp_path):
    return save_tetrahedron(tmp_path / "part.usda")


def layered(path, kind, asset):
    """A stage with a mesh that composes ``asset`` by an arc of ``kind``."""
    stage = new_stage()
    add_mesh(stage, "/own", TETRAHEDRON + 2)
    if kind == "sublayer":
        stage.GetRootLayer().subLayerPaths.append(asset)
    elif kind == "variant":
        variants = stage.DefinePrim("/other").GetVariantSets().AddVariantSet("which")
        variants.AddVariant("far")
        variants.SetVariantSelection("far")
        with variants.GetVariantEditContext():
            stage.GetPrimAtPath("/other").GetReferences().AddReference(asset, "/World")
        variants.ClearVariantSelection()
    elif kind == "clips":
        Usd.ClipsAPI(stage.DefinePrim("/other")).SetClips({"default": {"assetPaths": Sdf.AssetPathArray([asset])}})
    else:
        prim = stage.DefinePrim("/other")
        getattr(prim, f"Get{kind.capitalize()}s")().__getattribute__(f"Add{kind.capitalize()}")(asset, "/World")
    return save(stage, path)


@pytest.mark.parametrize("kind", ["reference", "payload", "sublayer"])
def test_usd_layers_next_to_and_below_the_file_are_read(tetrahedron, tmp_path, kind):
    (tmp_path / "sub").mkdir()
    tetrahedron.rename(tmp_path / "sub" / "part.usda")
    path = layered(tmp_path / "a.usda", kind, "./sub/part.usda")
    assert len(load_mesh(path).faces) == 8


@pytest.mark.parametrize("kind", ["reference", "payload", "sublayer", "variant"])
@pytest.mark.parametrize("how", ["up", "absolute", "link", "package"])
def test_usd_layers_elsewhere_are_refused_unless_trusted(tetrahedron, tmp_path, kind, how):
    folder = tmp_path / "inner"
    folder.mkdir()
    asset = {"up": "../part.usda", "absolute": str(tetrahedron), "link": "./link.usda"}.get(
        how, "../part.usdz[part.usda]"
    )
    if how == "link":
        os.symlink(tetrahedron, folder / "link.usda")
    if how == "package":
        assert UsdUtils.CreateNewUsdzPackage(str(tetrahedron), str(tmp_path / "part.usdz"))
    path = layered(folder / "a.usda", kind, asset)
    with pytest.raises(
        MeshError, match=r"the stage refers to '.*part.*', outside of its folder|link.usda', outside of its"
    ):
        load_mesh(path)
    if kind != "variant":
        assert len(load_mesh(path, trusted=True).faces) == 8


@pytest.mark.parametrize(
    ("asset", "message"),
    [
        ("/etc/passwd", "the stage refers to '/etc/passwd', outside of its folder"),
        ("http://example.org/a.usda", "the stage refers to 'http://example.org/a.usda', which is not a file"),
        ("./none.usda", "the stage refers to './none.usda', which does not exist"),
        ("./text.txt", "the stage refers to './text.txt'; allowed: files of type .usd"),
        ("./broken.usda", "not valid USD"),
    ],
)
def test_invalid_usd_layer_is_refused(tmp_path, asset, message):
    (tmp_path / "text.txt").write_text("#usda 1.0\n")
    (tmp_path / "broken.usda").write_text("#usda 1.0\n(((")
    with pytest.raises(MeshError, match=message):
        load_mesh(layered(tmp_path / "a.usda", "reference", asset))


def test_usd_layers_are_not_searched_in_the_current_folder(tetrahedron, tmp_path, monkeypatch):
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path)  # the folder in which USD searches names that are not next to the file
    monkeypatch.setenv("PXR_AR_DEFAULT_SEARCH_PATH", str(tmp_path))
    with pytest.raises(MeshError, match=r"the stage refers to 'part.usda', outside of its folder"):
        load_mesh(layered(tmp_path / "inner" / "a.usda", "sublayer", "part.usda"))


def test_usd_package_cannot_refer_to_outside_files(tetrahedron, tmp_path):
    (tmp_path / "inner").mkdir()
    for asset in ("../part.usda", "../../part.usda", str(tetrahedron)):
        with zipfile.ZipFile(tmp_path / "inner" / "a.usdz", "w", zipfile.ZIP_STORED) as package:
            package.writestr("root.usda", f"#usda 1.0\n(\n subLayers = [@{asset}@]\n)\n")
        with pytest.raises(MeshError, match=r"cannot be opened|outside of its folder"):
            load_mesh(tmp_path / "inner" / "a.usdz")


def test_chain_of_usd_layers_is_checked_to_its_end(tetrahedron, tmp_path):
    folder = tmp_path / "inner"
    folder.mkdir()
    layered(folder / "b.usda", "sublayer", "../part.usda")
    with pytest.raises(MeshError, match=r"refers to '\.\./part.usda', outside"):
        load_mesh(layered(folder / "a.usda", "sublayer", "./b.usda"))


CLIPS = """clips = {
    dictionary default = {
        asset[] assetPaths = [@../secret.usda@]
        string primPath = "/World/hull"
    }
}"""


def prim(name, content="", metadata=""):
    return f'def Mesh "{name}" (\n{metadata}\n)\n{{\n{content}\n}}\n'


def variant(sets, name, content="", metadata=""):
    return f'variantSet "{sets}" = {{\n"{name}" (\n{metadata}\n) {{\n{content}\n}}\n}}\n'


FAR, DEEP = (
    f'variants = {{\nstring {sets} = "{name}"\n}}\nprepend variantSets = "{sets}"\n'
    for sets, name in (("which", "far"), ("how", "deep"))
)
WHERE = {
    "prim": (prim("m", metadata=CLIPS), "/m"),
    "child": (prim("m", prim("a", metadata=CLIPS)), "/m/a"),
    "class": (prim("m", metadata="inherits = </c>") + prim("c", metadata=CLIPS).replace("def", "class"), "/c"),
    "variant": (prim("m", variant("which", "far", metadata=CLIPS), FAR), "/m{which=far}"),
    "variant not chosen": (prim("m", variant("which", "near", metadata=CLIPS), FAR), "/m{which=near}"),
    "prim in a variant": (prim("m", variant("which", "far", prim("a", metadata=CLIPS)), FAR), "/m{which=far}a"),
    "nested variant": (
        prim("m", variant("which", "far", variant("how", "deep", metadata=CLIPS), DEEP), FAR),
        "/m{which=far}{how=deep}",
    ),
}


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("layer", ["root", "sublayer", "reference", "usdz"])
def test_value_clips_are_refused_on_any_prim(tmp_path, where, layer):
    text, place = WHERE[where]
    clipped, path = f"#usda 1.0\n{text}", tmp_path / "a.usda"
    if layer == "root":
        path.write_text(clipped)
    elif layer == "usdz":
        path = path.with_suffix(".usdz")
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as package:
            package.writestr("root.usda", "#usda 1.0\n(\n subLayers = [@./b.usda@]\n)\n")
            package.writestr("b.usda", clipped)
    else:
        (tmp_path / "b.usda").write_text(clipped)
        path.write_text(
            "#usda 1.0\n(\nsubLayers = [@./b.usda@]\n)\n"
            if layer == "sublayer"
            else "#usda 1.0\n" + prim("r", metadata="references = @./b.usda@</m>")
        )
    with pytest.raises(Unreadable, match=f"value clips at {re.escape(place)} are read"):
        check_layers(path, confined=True)
    check_layers(path, confined=False)


def test_value_clips_in_a_variant_can_read_outside_files_only_if_trusted(tmp_path):
    # Reason for the rejection: without it, points of a file elsewhere would become vertices of this mesh.
    (tmp_path / "inner").mkdir()
    secret, stage = new_stage(), new_stage()
    points = Vt.Vec3fArray([Gf.Vec3f(*map(float, 7.0 * v)) for v in TETRAHEDRON])
    add_mesh(secret, "/World/hull").GetPointsAttr().Set(points, 0.0)
    save(secret, tmp_path / "secret.usda")
    mesh = add_mesh(stage, "/m")
    mesh.GetPointsAttr().Clear()
    variants = mesh.GetPrim().GetVariantSets().AddVariantSet("which")
    variants.AddVariant("far")
    variants.SetVariantSelection("far")
    clips = {
        "assetPaths": Sdf.AssetPathArray(["../secret.usda"]), "primPath": "/World/hull",
        "manifestAssetPath": Sdf.AssetPath("../secret.usda"),
        "active": Vt.Vec2dArray([(0, 0)]), "times": Vt.Vec2dArray([(0, 0)]),
    }  # fmt: skip
    with variants.GetVariantEditContext():
        Usd.ClipsAPI(mesh.GetPrim()).SetClips({"default": clips})
    path = save(stage, tmp_path / "inner" / "a.usda")
    assert load_mesh(path, trusted=True).bounds[1, 0] == 7.0
    with pytest.raises(MeshError, match=r"value clips at /m\{which=far\}"):
        load_mesh(path)


def test_value_clips_are_refused_unless_trusted(tetrahedron, tmp_path):
    path = layered(tmp_path / "a.usda", "clips", "../elsewhere.usda")
    with pytest.raises(MeshError, match="value clips at /other"):
        load_mesh(path)
    assert len(load_mesh(path, trusted=True).faces) == 4
