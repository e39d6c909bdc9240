"""Makes the small copies in models/ from the originals: textures scaled to 512 pixels and stored as JPEG.

    python make_models.py SCENES     (SCENES: a folder with gltf/Avocado, gltf/Suzanne, gltf/Fox.glb and mesh/spot)

Needs Pillow. The sources and their licences are in LICENSES.md.
"""
import json
import pathlib
import shutil
import sys

from PIL import Image

here = pathlib.Path(__file__).parent / "models"
scenes = pathlib.Path(sys.argv[1])
here.mkdir(exist_ok=True)

for name in ["Avocado", "Suzanne"]:
    source = scenes / "gltf" / name
    gltf = json.loads((source / f"{name}.gltf").read_text())
    for image in gltf["images"]:
        picture = Image.open(source / image["uri"]).convert("RGB")
        picture = picture.resize((512, 512), Image.LANCZOS)
        image["uri"] = pathlib.Path(image["uri"]).stem.lower() + ".jpg"
        image.pop("mimeType", None)
        picture.save(here / image["uri"], quality=90)
    buffer = gltf["buffers"][0]
    shutil.copyfile(source / buffer["uri"], here / f"{name.lower()}.bin")
    buffer["uri"] = f"{name.lower()}.bin"
    (here / f"{name.lower()}.gltf").write_text(json.dumps(gltf, indent=1))

shutil.copyfile(scenes / "gltf" / "Fox.glb", here / "fox.glb")

spot = (scenes / "mesh" / "spot" / "spot_triangulated.obj").read_text()
(here / "spot.obj").write_text("mtllib spot.mtl\nusemtl spot\n" + spot)
(here / "spot.mtl").write_text("newmtl spot\nKd 1 1 1\nKs 0.2 0.2 0.2\nNs 60\nmap_Kd spot.jpg\n")
Image.open(scenes / "mesh" / "spot" / "spot_texture.png").convert("RGB").resize((512, 512), Image.LANCZOS).save(
    here / "spot.jpg", quality=90
)
