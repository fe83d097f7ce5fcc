//! Small files in formats that loaders read but no sink writes.

use safetensors::tensor::{Dtype, TensorView, serialize};

/// An ASCII PLY file that contains a quad with one corner raised.
pub const MESH_PLY: &str = "ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 1
property list uchar int vertex_indices
end_header
-2 -2 0 200 90 90
2 -2 0 90 200 90
2 2 0 90 90 200
-2 2 3 200 200 200
4 0 1 2 3
";

/// Two cameras in two lists, in the JSON format of this program.
pub const CAMERAS_JSON: &str = r#"{
  "views": [
    {"name": "a", "w": 24, "h": 16, "fx": 20, "fy": 20, "cx": 12, "cy": 8,
     "c2w_opencv": [[1,0,0,0],[0,0,1,-3],[0,-1,0,1],[0,0,0,1]]},
    {"name": "b", "w": 24, "h": 16, "fx": 20, "fy": 20, "cx": 12, "cy": 8,
     "c2w_opencv": [[1,0,0,1],[0,0,1,-3],[0,-1,0,1],[0,0,0,1]]}
  ],
  "cube_faces": [
    {"name": "c", "w": 12, "h": 8, "fx": 20, "fy": 20, "cx": 6, "cy": 4,
     "c2w_opencv": [[1,0,0,0],[0,0,1,-5],[0,-1,0,1],[0,0,0,1]]}
  ]
}"#;

/// The file in which nerfstudio's data parser stores its transform.
pub const DATAPARSER_JSON: &str = r#"{"transform": [[0,-1,0,1],[1,0,0,0],[0,0,1,0]], "scale": 0.5}"#;

/// INRIA PLY file with `n` splats of degree 1 along a line. The last splat is large.
pub fn splats_ply(n: usize) -> Vec<u8> {
    let mut names: Vec<String> =
        ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from).into();
    names.extend((0..9).map(|i| format!("f_rest_{i}")));
    names.extend(
        ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(String::from),
    );
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {n}\n").into_bytes();
    for name in &names {
        bytes.extend_from_slice(format!("property float {name}\n").as_bytes());
    }
    bytes.extend_from_slice(b"end_header\n");
    for i in 0..n {
        let size = if i + 1 == n { -1.0 } else { -2.5 };
        // The first one stands close to the camera.
        let y = if i == 0 { -2.0 } else { 0.0 };
        // The last one is so red that it clips.
        let red = if i + 1 == n { 4.0 } else { 0.3 };
        let mut row = vec![i as f32 * 0.1 - 0.5, y, 0.5, 0.0, 0.0, 0.0, red, -0.2, 0.1 * i as f32];
        row.extend((0..9).map(|k| 0.05 * k as f32));
        row.extend([1.5, size, size - 0.2, size + 0.1, 1.0, 0.1, 0.2, 0.0]);
        row.iter().for_each(|v: &f32| bytes.extend_from_slice(&v.to_le_bytes()));
    }
    bytes
}

/// GLB file with two scenes. Each scene contains one triangle, and the two triangles have different sizes. The node of
/// the first triangle has a camera, and the animation `walk` moves it for one second.
pub fn object_glb() -> Vec<u8> {
    let mut buffer = Vec::new();
    for size in [0.5_f32, 0.3] {
        for v in [[0.0, 0.0, 0.0], [size, 0.0, 0.0], [0.0, size, 0.0]] {
            v.iter().for_each(|c: &f32| buffer.extend_from_slice(&c.to_le_bytes()));
        }
    }
    // The times of two keys, then their translations.
    let keys = [0.0_f32, 1.0, 0.0, 0.0, 0.0, 0.2, 0.1, 0.3];
    buffer.extend(keys.iter().flat_map(|value| value.to_le_bytes()));
    let accessor = |at: usize, size: f32| {
        format!(
            r#"{{"bufferView":0,"byteOffset":{at},"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[{size},{size},0]}}"#
        )
    };
    let mut json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}},{{"nodes":[1]}}],
"nodes":[{{"mesh":0,"camera":0}},{{"mesh":1}}],
"cameras":[{{"type":"perspective","perspective":{{"yfov":0.8,"znear":0.1}}}}],
"animations":[{{"name":"walk","samplers":[{{"input":2,"output":3}}],"channels":[{{"sampler":0,"target":{{"node":0,"path":"translation"}}}}]}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}},{{"primitives":[{{"attributes":{{"POSITION":1}},"material":0}}]}}],
"materials":[{{"doubleSided":true,"pbrMetallicRoughness":{{"baseColorFactor":[0.8,0.3,0.2,1],"metallicFactor":0.2,"roughnessFactor":0.6}}}}],
"buffers":[{{"byteLength":{}}}],"bufferViews":[{{"buffer":0,"byteLength":{}}}],"accessors":[{},{},
{{"bufferView":0,"byteOffset":72,"componentType":5126,"count":2,"type":"SCALAR"}},
{{"bufferView":0,"byteOffset":80,"componentType":5126,"count":2,"type":"VEC3"}}]}}"#,
        buffer.len(),
        buffer.len(),
        accessor(0, 0.5),
        accessor(36, 0.3)
    )
    .into_bytes();
    while json.len() % 4 != 0 {
        json.push(b' ');
    }
    let mut glb = Vec::new();
    glb.extend_from_slice(b"glTF");
    for word in [2, (12 + 8 + json.len() + 8 + buffer.len()) as u32, json.len() as u32] {
        glb.extend_from_slice(&word.to_le_bytes());
    }
    glb.extend_from_slice(b"JSON");
    glb.extend_from_slice(&json);
    glb.extend_from_slice(&(buffer.len() as u32).to_le_bytes());
    glb.extend_from_slice(b"BIN\0");
    glb.extend_from_slice(&buffer);
    glb
}

/// Weights file of LPIPS with AlexNet, with two channels per layer.
pub fn lpips_safetensors() -> Vec<u8> {
    let value = |i: usize| ((i * 7919) % 31) as f32 / 64.0;
    let bytes = |n: usize| (0..n).flat_map(|i| (value(i) - 0.2).to_le_bytes()).collect::<Vec<u8>>();
    let mut tensors = Vec::new();
    for (k, size) in [11, 5, 3, 3, 3].into_iter().enumerate() {
        let shape = [2, if k == 0 { 3 } else { 2 }, size, size];
        tensors.push((format!("conv{k}.weight"), shape.to_vec(), bytes(shape.iter().product())));
        tensors.push((format!("conv{k}.bias"), vec![2], 0.5_f32.to_le_bytes().repeat(2)));
        tensors.push((format!("lin{k}.weight"), vec![1, 2, 1, 1], 1_f32.to_le_bytes().repeat(2)));
    }
    let views = tensors.iter().map(|(name, shape, bytes)| {
        (name, TensorView::new(Dtype::F32, shape.clone(), bytes).expect("shape and bytes agree"))
    });
    serialize(views, None).expect("names differ")
}

/// The shipped weights file, changed so that it predicts a different amount of hidden light.
pub fn exposure_safetensors() -> Vec<u8> {
    let shipped = include_bytes!("../../../render/weights/exposure.safetensors");
    let shipped = safetensors::SafeTensors::deserialize(shipped).expect("is sound");
    let bias = 2.0_f32.to_le_bytes();
    let views = shipped.iter().map(|(name, view)| match name {
        "amount.bias" => (name, TensorView::new(Dtype::F32, vec![1], &bias).expect("shape and bytes agree")),
        _ => (name, view),
    });
    serialize(views, None).expect("names differ")
}

/// A stand-in for COLMAP, which copies the photographs and the model in the folder `model` next to it.
pub const COLMAP: &str = "#!/bin/sh
here=$(dirname \"$0\")
case $1 in
help) echo COLMAP 3.8;;
mapper) mkdir sparse/0; cp \"$here\"/MODEL/*.bin sparse/0;;
image_undistorter) mkdir out/sparse out/images; cp \"$here\"/MODEL/*.bin out/sparse; cp photos/* out/images;;
esac
";

/// A stand-in for a Python with OpenColorIO, which copies pictures; `-b` exchanges bytes: `ocio.sh CODE REQUEST`.
pub const OCIO: &str = "#!/bin/sh
for f in *.f32; do LC_ALL=C tr FROM < $f > out/$f; done
echo '{\"version\": \"2\", \"from\": \"A\", \"to\": \"B\"}' > out/done.json
grep -q ACEScg $2 && for f in *.f32; do LC_ALL=C tr '\\076' '\\074' < $f > out/$f; done
exit 0
";

/// A stand-in for a trainer, which copies files next to it: `stand-in.sh PHOTOS OUT [OTHER]`.
pub const TRAINER: &str = "#!/bin/sh
here=$(dirname \"$0\")
cp \"$here/FIRST\" \"$2/splats.ply\"
test $# = 3 && cp \"$here/b.ply\" \"$2/splats.ply\"
cp \"$here/b.ply\" \"$2/other.ply\"
cp \"$here/mesh.ply\" \"$2/mesh.ply\"
sed 's/^-2 2 3/-2 2 2/' \"$here/mesh.ply\" > \"$2/other-mesh.ply\"
";

/// A binary COLMAP model with a camera for each photograph of the fixture, side by side: `cameras`, `images` and
/// `points3D`. `shift` moves the cameras.
pub fn colmap_model(shift: f64) -> [Vec<u8>; 3] {
    let mut cameras = 1_u64.to_le_bytes().to_vec();
    cameras.extend([1_u32, 1].map(u32::to_le_bytes).as_flattened());
    cameras.extend([48_u64, 32].map(u64::to_le_bytes).as_flattened());
    cameras.extend([40.0_f64, 40.0, 24.0, 16.0].map(f64::to_le_bytes).as_flattened());
    let mut images = 6_u64.to_le_bytes().to_vec();
    for index in 0..6_u32 {
        images.extend((index + 1).to_le_bytes());
        let pose = [1.0, 0.0, 0.0, 0.0, -f64::from(index) - shift, 0.0, 3.0];
        images.extend(pose.map(f64::to_le_bytes).as_flattened());
        images.extend(1_u32.to_le_bytes());
        images.extend(format!("capture{index:03}.png").as_bytes());
        images.extend([0; 9]);
    }
    let mut points = 9_u64.to_le_bytes().to_vec();
    for index in 0..9_u64 {
        points.extend(index.to_le_bytes());
        points.extend([index as f64 * 0.5, 1.5, 1.0].map(f64::to_le_bytes).as_flattened());
        points.extend([200, 100, 50]);
        points.extend(0.4_f64.to_le_bytes());
        points.extend(0_u64.to_le_bytes());
    }
    [cameras, images, points]
}
