"""Lightharmony in Blender: renders the selected object into a Gaussian splat capture, and exports scenes to COLMAP.

The sidebar of the 3D viewport has the tab Lightharmony. `Render into Capture` writes a graph for the camera of the scene
and the active object, runs it again whenever either moves, and shows the result as an image and as the background of
the camera. `Export to COLMAP` renders the scene from the camera at every frame, with and without the selected objects,
and writes cameras, depth and points.

World coordinates of Blender are used everywhere: z up, one unit is `Unit Scale` metres.
"""

import json
import math
import os
import struct
import tempfile

import bpy
import numpy
from bpy.app.handlers import persistent
from bpy.props import BoolProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from mathutils import Matrix

try:
    # The copy in the package of this extension.
    from . import lightharmony
except ImportError:
    import lightharmony

IMAGE = "Lightharmony"
"""Name of the image that shows the result."""

INTERVAL = 0.2
"""Time in seconds between two looks at the scene and at the events of the program."""


class Refused(Exception):
    """The scene cannot be rendered as it is. The message states what to change."""


# Cameras


def camera_of(scene):
    """The camera of the scene at the current frame as a view in the format of `load-cameras`.

    Sensor fit, lens shift and pixel aspect are part of the focal lengths and the principal point.
    """
    camera = scene.camera
    if camera is None:
        raise Refused("the scene has no camera; add one, or make it the active camera (Ctrl Numpad 0)")
    if camera.data.type != "PERSP":
        raise Refused(f"the camera `{camera.name}` is not a perspective camera")
    render = scene.render
    scale = render.resolution_percentage / 100
    width, height = (max(1, int(size * scale)) for size in (render.resolution_x, render.resolution_y))
    # Corners of the picture at a distance of 1.
    frame = [corner / -corner.z for corner in camera.data.view_frame(scene=scene)]
    left, right = min(corner.x for corner in frame), max(corner.x for corner in frame)
    bottom, top = min(corner.y for corner in frame), max(corner.y for corner in frame)
    return {
        "name": camera.name,
        "w": width,
        "h": height,
        "fx": width / (right - left),
        "fy": height / (top - bottom),
        "cx": -left / (right - left) * width,
        "cy": top / (top - bottom) * height,
        # Without the scale of the camera, which does not affect its picture.
        "c2w_opengl": [list(row) for row in camera.matrix_world.normalized()],
    }


# Objects


def parts_of(root):
    """`root` and the objects below it that have a surface."""
    kinds = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
    return [one for one in [root, *root.children_recursive] if one.type in kinds and one.visible_get()]


def rigid(matrix):
    """The translation and rotation of a transform, without scale, shear and reflection."""
    place, turn, _ = matrix.decompose()
    return Matrix.LocRotScale(place, turn, None)


def export_glb(context, roots, path, origin):
    """Writes objects with their modifiers as GLB, in coordinates relative to the transform `origin`.

    Parents, constraints and animations are applied. The file is written only if its content differs.
    """
    depsgraph = context.evaluated_depsgraph_get()
    into = origin.inverted()
    selected, active = list(context.selected_objects), context.view_layer.objects.active
    collection = bpy.data.collections.new("lightharmony export")
    context.scene.collection.children.link(collection)
    made = []
    try:
        for one in selected:
            one.select_set(False)
        for part in (part for root in roots for part in parts_of(root)):
            evaluated = part.evaluated_get(depsgraph)
            mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
            copy = bpy.data.objects.new(part.name, mesh)
            made.append(copy)
            copy.matrix_world = into @ evaluated.matrix_world
            collection.objects.link(copy)
            copy.select_set(True)
        if not any(len(copy.data.polygons) for copy in made):
            names = ", ".join(root.name for root in roots)
            raise Refused(f"`{names}` has no visible surface; select a mesh object")
        context.view_layer.objects.active = made[0]
        context.view_layer.update()
        with tempfile.TemporaryDirectory() as folder:
            new = os.path.join(folder, "object.glb")
            bpy.ops.export_scene.gltf(
                filepath=new, export_format="GLB", use_selection=True, export_yup=True, export_apply=False,
                export_animations=False, export_cameras=False, export_lights=False, export_extras=False,
            )
            with open(new, "rb") as file:
                replace(path, file.read())
    finally:
        for copy in made:
            mesh = copy.data
            bpy.data.objects.remove(copy)
            bpy.data.meshes.remove(mesh)
        bpy.data.collections.remove(collection)
        for one in selected:
            one.select_set(True)
        context.view_layer.objects.active = active


def replace(path, content):
    """Writes a file as a whole, unless it has this content already. Returns true if it was written."""
    try:
        with open(path, "rb") as file:
            if file.read() == content:
                return False
    except OSError:
        pass
    os.makedirs(os.path.dirname(path), exist_ok=True)
    temporary = f"{path}.{os.getpid()}.new"
    with open(temporary, "wb") as file:
        file.write(content)
    os.replace(temporary, path)
    return True


# Graphs

GRAPH = """// Written by the Blender extension of lightharmony, which replaces this file.
Graph(
    version: 1,
    scene: (up: "+z", metres_per_unit: {metres}, seed: 7),
    nodes: (
        scene:  LoadSplats(path: {splats}{matrix}),
        proxy:  {proxy},
        object: LoadObject(path: "object.glb"),
        pose:   Pose(matrix: {pose}),
        placed: Place(object: "object", pose: "pose"),
        camera: LoadCameras(path: "camera.json"),

        probe:  CubeRig(at: "pose", height_metres: {probe}, size_px: 256),
        faces:  SplatRender(splats: "scene", rig: "probe"),
        pano:   Stitch(views: "faces", width_px: 1024),
        dark:   PredictExposure(pano: "pano", evs: [-6.0, -3.0], method: Learned),
        env:    FuseHdr(base: "pano", brackets: "dark"),

        view:   SplatRender(splats: "scene", rig: "camera"),
        trace:  PathTrace(
            receiver: "proxy", objects: ["placed"], rig: "camera", env: "env", samples: {samples}, clamp_indirect: 4.0,
        ),
        clean:  Denoise(
            without: "trace.without", with: "trace.with", object: "trace.object",
            depth: "trace.depth", normal: "trace.normal", variance: "trace.variance",
        ),
        shadow: ShadowRatio(without: "clean.without", with: "clean.with"),
        front:  SplatRender(splats: "scene", rig: "camera", limit: "trace.nearest"),
        final:  Composite(background: "view", object: "clean.object", shadow: "shadow", front: "front"),
        save:   WriteImage(image: "final", path: "picture.png"),
        layers: WriteExr(
            layers: ["view.colour", "shadow", "clean.object", "front.colour", "trace.depth"],
            names: ["B", "S", "O", "F", "Z"], encoding: Linear, path: "layers.exr",
        ),
    ),
)
"""


def numbers(matrix):
    """A matrix in the notation of graphs."""
    return "(" + ", ".join(f"{value:.9g}" if value else "0" for row in matrix for value in row) + ")"


def quoted(text):
    """Text in the notation of graphs."""
    return json.dumps(text, ensure_ascii=False)


class Job:
    """The files of one graph, and what they depend on."""

    def __init__(self, context):
        settings = context.scene.lightharmony
        self.scene, self.root = context.scene, context.view_layer.objects.active
        if self.root is None or not parts_of(self.root):
            raise Refused("select the object to insert: a visible object with a surface")
        if self.root in (settings.place, settings.capture):
            raise Refused(f"`{self.root.name}` is the place; select the object to insert")
        self.splats = bpy.path.abspath(settings.splats)
        if not settings.splats or not os.path.exists(self.splats):
            raise Refused(f"the splat file `{self.splats}` does not exist" if settings.splats else "choose a splat file")
        self.folder = os.path.abspath(bpy.path.abspath(settings.folder))
        if settings.folder.startswith("//") and not bpy.data.filepath:
            raise Refused("save the .blend file first, or choose a folder that does not begin with //")
        self.settings = settings

    @property
    def graph(self):
        """Path of the graph."""
        return os.path.join(self.folder, "graph.ron")

    @property
    def picture(self):
        """Path of the rendered picture."""
        return os.path.join(self.out, "picture.png")

    @property
    def out(self):
        """Output folder of the graph."""
        return os.path.join(self.folder, "out")

    def export(self, context):
        """Writes the object and the mesh of the place. Moving them does not change these files, but scaling does.

        A mesh that is extracted from the splats is finest around the position that the object has now.
        """
        self.anchor = self.root.matrix_world.translation.copy()
        export_glb(context, [self.root], os.path.join(self.folder, "object.glb"), rigid(self.root.matrix_world))
        if self.settings.place:
            export_glb(context, [self.settings.place], os.path.join(self.folder, "place.glb"), Matrix())

    def write(self):
        """Writes the camera and the graph. Returns true if one of them has changed."""
        settings, metres = self.settings, self.scene.unit_settings.scale_length
        # glTF is in metres, so its coordinates are divided by the metres per unit when it is loaded.
        pose = rigid(self.root.matrix_world) @ Matrix.Scale(metres, 4)
        place = f', matrix: {numbers(settings.capture.matrix_world)}' if settings.capture else ""
        # Not around the pose itself, so that a move of the object does not extract the mesh again.
        place_of_mesh = ", ".join(f"{value:.9g}" for value in self.anchor)
        proxy = f'ExtractMesh(splats: "scene", around: "anchor"),\n        anchor: Pose(translation: ({place_of_mesh}))'
        if settings.place:
            proxy = f'LoadMesh(path: "place.glb", frame: Gltf, matrix: {numbers(Matrix.Scale(metres, 4))})'
        text = GRAPH.format(
            metres=f"{metres:.9g}", splats=quoted(self.splats), matrix=place, proxy=proxy, pose=numbers(pose),
            probe=f"{settings.probe_height:.6g}", samples=settings.samples,
        )
        camera = json.dumps({"views": [camera_of(self.scene)]}, indent=1)
        changed = replace(os.path.join(self.folder, "camera.json"), camera.encode())
        return replace(self.graph, text.encode()) or changed


# Watching


class Session:
    """A graph that is being watched, and its state."""

    def __init__(self, job):
        self.job, self.state = job, "starting"
        self.mistakes = []
        # Without the layers, which would take time after every preview.
        self.watch = lightharmony.watch(job.graph, only="save", out=job.out, program=program_path())

    def step(self):
        """Writes what has moved, and handles the events that have arrived. Returns true if the state has changed."""
        before = self.state, len(self.mistakes)
        try:
            self.job.write()
        except Refused as refused:
            self.state = str(refused)
        for event in self.watch.poll():
            self.handle(event)
        return before != (self.state, len(self.mistakes))

    def handle(self, event):
        """Updates the state for an event of the program."""
        name = event["event"]
        if name == "plan":
            self.state, self.mistakes = f"rendering, about {event['seconds']:.0f} s", []
        elif name == "start":
            self.state = f"rendering: {event['id']}"
        elif name == "progress":
            self.state = f"rendering: {event['id']} {100 * event['fraction']:.0f} %"
        elif name == "mistakes":
            self.state, self.mistakes = "the graph cannot run", self.watch.mistakes_of(event)
        elif name == "file" and event["id"] == "save":
            show(self.job.scene, self.job.picture)
            if event.get("preview"):
                self.state = "preview"
        elif name == "idle" and not self.mistakes:
            self.state = "up to date"

    def close(self):
        """Ends the program."""
        self.watch.close()


session = None
"""The running `Session`, or None."""


def program_path():
    """Path of the program from the preferences. None if it is to be searched."""
    addon = bpy.context.preferences.addons.get(__package__ or __name__)
    path = addon.preferences.program if addon and addon.preferences else ""
    return bpy.path.abspath(path) or None


def show(scene, path):
    """Shows a picture file as the image `Lightharmony` and as the background of the camera."""
    image = bpy.data.images.get(IMAGE)
    if image is None:
        image = bpy.data.images.load(path)
        image.name = IMAGE
    elif bpy.path.abspath(image.filepath) != path:
        image.filepath = path
    image.reload()
    camera = scene.camera.data
    background = next((one for one in camera.background_images if one.image == image), None)
    if background is None:
        background = camera.background_images.new()
        background.image = image
    background.alpha, background.display_depth, background.frame_method = 1.0, "FRONT", "STRETCH"
    camera.show_background_images = True
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR" and area.spaces.active.image is None:
                area.spaces.active.image = image
            area.tag_redraw()
    return image


def tick():
    """The timer of a watched graph. Returns the time in seconds until the next call; None ends the timer."""
    if session is None:
        return None
    try:
        changed = session.step()
    except (lightharmony.Error, OSError, ReferenceError) as error:
        # ReferenceError: the object or the scene was deleted.
        message = "the object was deleted" if isinstance(error, ReferenceError) else str(error)
        stop()
        status.text = message
        changed = True
    if changed:
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()
    return INTERVAL if session is not None else None


class status:
    """The last error after the session has ended."""

    text = ""


def stop():
    """Ends the watched graph."""
    global session
    if session is not None:
        session.close()
        session = None


@persistent
def on_load(_):
    """Ends the watched graph when another file is opened."""
    stop()


# Export to COLMAP


def depth_of(context, view):
    """Planar depth at the centre of each pixel, +inf where there is no surface: an array (height, width) of float32."""
    depsgraph, scene = context.evaluated_depsgraph_get(), context.scene
    world = Matrix(view["c2w_opengl"])
    turn, eye = world.to_3x3(), world.translation
    forward = turn @ -Matrix.Identity(3).col[2]
    depth = numpy.full((view["h"], view["w"]), numpy.inf, numpy.float32)
    for y in range(view["h"]):
        for x in range(view["w"]):
            ray = turn @ ray_of(view, x, y)
            hit, point, *_ = scene.ray_cast(depsgraph, eye, ray.normalized(), distance=1e9)
            if hit:
                depth[y, x] = (point - eye).dot(forward)
    return depth


def ray_of(view, x, y):
    """Direction through the centre of a pixel in the axes of the camera (x right, y up, z backward), with z = -1."""
    from mathutils import Vector

    return Vector(((x + 0.5 - view["cx"]) / view["fx"], -(y + 0.5 - view["cy"]) / view["fy"], -1.0))


def write_depth(path, depth):
    """Writes an uncompressed OpenEXR file with the channel `Z` in 32 bits."""
    height, width = depth.shape

    def attribute(name, kind, value):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(value)) + value

    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    header = struct.pack("<II", 20000630, 2)
    header += attribute("channels", "chlist", b"Z\0" + struct.pack("<iB3xii", 2, 0, 1, 1) + b"\0")
    header += attribute("compression", "compression", b"\0")
    header += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    header += attribute("lineOrder", "lineOrder", b"\0")
    header += attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0))
    header += attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0.0, 0.0))
    header += attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)) + b"\0"
    size = 8 + 4 * width
    first = len(header) + 8 * height
    table = struct.pack(f"<{height}Q", *(first + size * y for y in range(height)))
    rows = (struct.pack("<iI", y, 4 * width) + depth[y].astype("<f4").tobytes() for y in range(height))
    replace(path, header + table + b"".join(rows))


def colmap_pose(view):
    """Rotation as a quaternion (w, x, y, z) and translation of COLMAP: from the world to a camera with x right, y down
    and z forward."""
    flip = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
    matrix = (Matrix(view["c2w_opengl"]) @ flip).inverted()
    return matrix.to_quaternion(), matrix.translation


def render(scene, path):
    """Renders the scene to a PNG file of 8 bits per channel."""
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "8"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True, scene=scene.name)


def pixels_of(path):
    """The colours of a picture file, first row at the top: an array (height, width, 3) of float32 from 0 to 1."""
    image = bpy.data.images.load(path)
    try:
        width, height = image.size
        flat = numpy.empty(4 * width * height, numpy.float32)
        image.pixels.foreach_get(flat)
        return flat.reshape(height, width, 4)[::-1, :, :3]
    finally:
        bpy.data.images.remove(image)


def export_colmap(context, folder, most_points, pairs, progress=lambda part: None):
    """Exports the scene for the training of splats, with ground truth for inserted objects.

    The active camera is exported at every frame of the scene. The selected objects are the inserted objects.

    - `images/NAME.png`: the place without these objects; `with/NAME.png`: with them (if `pairs`).
    - `depth/NAME.exr`: planar depth of the place without the objects, in the channel `Z`.
    - `sparse/0`: cameras, images and points of COLMAP as text. The points are surfaces that the cameras see, with
      their rendered colours.

    Returns the number of views and of points.
    """
    scene = context.scene
    frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    before = scene.frame_current
    hidden = [part for root in context.selected_objects if root.type != "CAMERA" for part in parts_of(root)]
    if pairs and not hidden:
        raise Refused("select the objects of the truth pairs, or switch the pairs off")
    render_settings = scene.render
    saved = [(owner, name, getattr(owner, name)) for owner, names in (
        (render_settings, ("filepath",)),
        (render_settings.image_settings, ("file_format", "color_mode", "color_depth")),
    ) for name in names]
    visible = [(part, part.hide_render, part.hide_viewport) for part in hidden]
    cameras, images, points = {}, [], []
    digits = max(4, len(str(frames[-1])))
    per_view = max(1, math.ceil(most_points / len(frames)))
    try:
        for index, frame in enumerate(frames):
            scene.frame_set(frame)
            view = camera_of(scene)
            name = f"{frame:0{digits}}.png"
            if pairs:
                render(scene, os.path.join(folder, "with", name))
            for part, *_ in visible:
                part.hide_render = part.hide_viewport = True
            context.view_layer.update()
            picture = os.path.join(folder, "images", name)
            render(scene, picture)
            depth = depth_of(context, view)
            write_depth(os.path.join(folder, "depth", f"{frame:0{digits}}.exr"), depth)
            for part, render_hidden, viewport_hidden in visible:
                part.hide_render, part.hide_viewport = render_hidden, viewport_hidden
            lens = tuple(view[key] for key in ("w", "h", "fx", "fy", "cx", "cy"))
            camera = cameras.setdefault(lens, len(cameras) + 1)
            images.append((name, camera, colmap_pose(view)))
            points += points_of(view, depth, pixels_of(picture), per_view, index)
            progress((index + 1) / len(frames))
    finally:
        for part, render_hidden, viewport_hidden in visible:
            part.hide_render, part.hide_viewport = render_hidden, viewport_hidden
        for owner, name, value in saved:
            setattr(owner, name, value)
        scene.frame_set(before)
    sparse = os.path.join(folder, "sparse", "0")
    text = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    text += "".join(f"{camera} PINHOLE {w} {h} {fx!r} {fy!r} {cx!r} {cy!r}\n" for (w, h, fx, fy, cx, cy), camera in cameras.items())
    replace(os.path.join(sparse, "cameras.txt"), text.encode())
    text = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
    for number, (name, camera, (turn, place)) in enumerate(images, 1):
        text += " ".join([str(number), *map(repr, turn), *map(repr, place), str(camera), name]) + "\n\n"
    replace(os.path.join(sparse, "images.txt"), text.encode())
    text = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
    for number, (place, colour) in enumerate(points, 1):
        text += f"{number} {place[0]:.6f} {place[1]:.6f} {place[2]:.6f} {colour[0]} {colour[1]} {colour[2]} 0\n"
    replace(os.path.join(sparse, "points3D.txt"), text.encode())
    return len(images), len(points)


def points_of(view, depth, picture, count, seed):
    """At most `count` points of the surfaces in a view, spread over its pixels, with their colours from 0 to 255."""
    rows, columns = numpy.nonzero(numpy.isfinite(depth))
    if not len(rows):
        return []
    chosen = numpy.random.default_rng(seed).permutation(len(rows))[:count]
    rows, columns = rows[chosen], columns[chosen]
    z = depth[rows, columns].astype(numpy.float64)
    x = (columns + 0.5 - view["cx"]) / view["fx"] * z
    y = -(rows + 0.5 - view["cy"]) / view["fy"] * z
    world = numpy.array(view["c2w_opengl"])
    places = numpy.stack([x, y, -z, numpy.ones_like(z)], axis=-1) @ world.T
    colours = numpy.rint(255 * picture[rows, columns]).astype(int).clip(0, 255)
    return list(zip(places[:, :3].tolist(), colours.tolist()))


# Interface


# Since Blender 4.5, a property must state that its path may begin with //, the folder of the .blend file.
RELATIVE = {"options": {"PATH_SUPPORTS_BLEND_RELATIVE"}} if bpy.app.version >= (4, 5, 0) else {}


class Settings(bpy.types.PropertyGroup):
    """Settings of a scene."""

    splats: StringProperty(name="Splats", subtype="FILE_PATH", **RELATIVE, description="The capture: PLY, SPZ, SOG, .splat, .ksplat")
    capture: PointerProperty(
        name="Capture", type=bpy.types.Object,
        description="An object whose transform places the splat file in the world, such as an empty. Without one, the coordinates of the file are those of the world",
    )
    place: PointerProperty(
        name="Mesh", type=bpy.types.Object,
        description="A mesh of the captured place, which receives the shadow. Without one, a mesh is extracted from the splats",
    )
    folder: StringProperty(name="Folder", subtype="DIR_PATH", default="//lightharmony", **RELATIVE, description="Folder of the graph and the pictures")
    samples: IntProperty(name="Samples", default=64, min=1, max=65536, description="Samples per pixel")
    probe_height: FloatProperty(name="Light at", default=0.3, min=0.0, unit="LENGTH", description="Height above the origin of the object at which the light is computed")
    colmap: StringProperty(name="Folder", subtype="DIR_PATH", default="//colmap", **RELATIVE, description="Folder of the exported scene")
    points: IntProperty(name="Points", default=100000, min=1, max=10000000, description="Maximum number of points")
    pairs: BoolProperty(name="Truth Pairs", default=True, description="Also render with the selected objects; `images` is without them")


class Preferences(bpy.types.AddonPreferences):
    """Preferences of the extension."""

    bl_idname = __package__ or __name__

    program: StringProperty(
        name="Program", subtype="FILE_PATH",
        description="The program `lightharmony`. Empty: LIGHTHARMONY_PROGRAM, or the first one on PATH",
    )

    def draw(self, _):
        self.layout.prop(self, "program")


class LIGHTHARMONY_OT_render(bpy.types.Operator):
    """Render the active object into the capture, and again whenever it or the camera moves"""

    bl_idname = "lightharmony.render"
    bl_label = "Render into Capture"

    def execute(self, context):
        global session
        stop()
        status.text = ""
        try:
            job = Job(context)
            job.export(context)
            job.write()
            session = Session(job)
        except (Refused, lightharmony.Error, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not bpy.app.timers.is_registered(tick):
            bpy.app.timers.register(tick, first_interval=INTERVAL)
        return {"FINISHED"}


class LIGHTHARMONY_OT_update(bpy.types.Operator):
    """Export the object and the mesh of the place again, after their shape or material has changed"""

    bl_idname = "lightharmony.update"
    bl_label = "Update Object"

    @classmethod
    def poll(cls, _):
        return session is not None

    def execute(self, context):
        try:
            session.job.export(context)
        except (Refused, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class LIGHTHARMONY_OT_layers(bpy.types.Operator):
    """Write the layers of the finished picture as OpenEXR: background, shadow, object, foreground, depth"""

    bl_idname = "lightharmony.layers"
    bl_label = "Write Layers"

    @classmethod
    def poll(cls, _):
        return session is not None and session.state == "up to date"

    def execute(self, _):
        job = session.job
        try:
            done = lightharmony.run(job.graph, only="layers", out=job.out, program=program_path())
        except (lightharmony.Error, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, ", ".join(map(str, done.files)))
        return {"FINISHED"}


class LIGHTHARMONY_OT_stop(bpy.types.Operator):
    """End the rendering"""

    bl_idname = "lightharmony.stop"
    bl_label = "Stop"

    @classmethod
    def poll(cls, _):
        return session is not None

    def execute(self, _):
        stop()
        return {"FINISHED"}


class LIGHTHARMONY_OT_colmap(bpy.types.Operator):
    """Render the camera at every frame without and with the selected objects, and write cameras, depth and points"""

    bl_idname = "lightharmony.colmap"
    bl_label = "Export to COLMAP"

    def execute(self, context):
        settings = context.scene.lightharmony
        manager = context.window_manager
        manager.progress_begin(0, 1)
        try:
            folder = os.path.abspath(bpy.path.abspath(settings.colmap))
            if settings.colmap.startswith("//") and not bpy.data.filepath:
                raise Refused("save the .blend file first, or choose a folder that does not begin with //")
            views, points = export_colmap(context, folder, settings.points, settings.pairs, manager.progress_update)
        except (Refused, OSError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            manager.progress_end()
        self.report({"INFO"}, f"{views} views and {points} points in {folder}")
        return {"FINISHED"}


class LIGHTHARMONY_PT_panel(bpy.types.Panel):
    """The tab in the sidebar."""

    bl_label = "Lightharmony"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Lightharmony"

    def draw(self, context):
        layout, settings = self.layout, context.scene.lightharmony
        layout.use_property_split = True
        for name in ("splats", "capture", "place", "folder", "samples", "probe_height"):
            layout.prop(settings, name)
        row = layout.row(align=True)
        row.operator("lightharmony.render", icon="RENDER_STILL")
        row.operator("lightharmony.stop", text="", icon="CANCEL")
        layout.operator("lightharmony.update", icon="FILE_REFRESH")
        layout.operator("lightharmony.layers", icon="RENDERLAYERS")
        state = session.state if session else status.text
        for line in [state, *(f"{one.line}:{one.column}: {one.message}" for one in (session.mistakes if session else ()))]:
            if line:
                layout.label(text=line)
        layout.separator()
        for name in ("colmap", "points", "pairs"):
            layout.prop(settings, name)
        layout.operator("lightharmony.colmap", icon="EXPORT")


CLASSES = (
    Settings, Preferences, LIGHTHARMONY_OT_render, LIGHTHARMONY_OT_update, LIGHTHARMONY_OT_layers, LIGHTHARMONY_OT_stop,
    LIGHTHARMONY_OT_colmap, LIGHTHARMONY_PT_panel,
)


def register():
    """Called by Blender when the extension is enabled."""
    for one in CLASSES:
        bpy.utils.register_class(one)
    bpy.types.Scene.lightharmony = PointerProperty(type=Settings)
    bpy.app.handlers.load_pre.append(on_load)


def unregister():
    """Called by Blender when the extension is disabled."""
    stop()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    bpy.app.handlers.load_pre.remove(on_load)
    del bpy.types.Scene.lightharmony
    for one in reversed(CLASSES):
        bpy.utils.unregister_class(one)
