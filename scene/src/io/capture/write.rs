//! Photographs with their cameras as a folder that other programs read: pictures and a binary COLMAP model.

use glam::{DMat3, DQuat};

use crate::error::Error;
use crate::io::png::{Raster, write};
use crate::types::{Camera, Photo, Photos};

/// Number of the camera model `PINHOLE` in binary files.
const PINHOLE: u32 = 1;

/// The files of the folder, apart from the pictures, as pairs of path and content. The coordinates are those of the
/// cameras.
pub fn model(photos: &Photos) -> [(&'static str, Vec<u8>); 3] {
    let count = (photos.photos.len() as u64).to_le_bytes();
    let (mut cameras, mut images) = (count.to_vec(), count.to_vec());
    for (photo, id) in photos.photos.iter().zip(1_u32..) {
        let camera = &photo.camera;
        cameras.extend([id, PINHOLE].map(u32::to_le_bytes).as_flattened());
        cameras.extend(
            [camera.width_px, camera.height_px].map(|side| u64::from(side).to_le_bytes()).as_flattened(),
        );
        cameras.extend([camera.fx, camera.fy, camera.cx, camera.cy].map(f64::to_le_bytes).as_flattened());
        images.extend(id.to_le_bytes());
        images.extend(pose(camera).map(f64::to_le_bytes).as_flattened());
        images.extend(id.to_le_bytes());
        images.extend(file_name(photo).as_bytes());
        // The end of the name, and no points.
        images.extend([0; 9]);
    }
    let mut points = (photos.points.len() as u64).to_le_bytes().to_vec();
    for (point, id) in photos.points.iter().zip(1_u64..) {
        points.extend(id.to_le_bytes());
        points.extend(point.position.map(|v| f64::from(v).to_le_bytes()).as_flattened());
        points.extend(point.rgb.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        // The error is unknown, and there are no observations.
        points.extend([0; 16]);
    }
    [("sparse/0/cameras.bin", cameras), ("sparse/0/images.bin", images), ("sparse/0/points3D.bin", points)]
}

/// The rotation as a quaternion with the real part first, and the translation, from world to camera.
fn pose(camera: &Camera) -> [f64; 7] {
    let world = camera.camera_from_world();
    let q = DQuat::from_mat3(&DMat3::from_mat4(world)).normalize();
    let t = world.w_axis;
    [q.w, q.x, q.y, q.z, t.x, t.y, t.z]
}

/// Name of the picture of a photograph, in the folders `images` and `masks`. The names of cameras contain no `/`.
pub fn file_name(photo: &Photo) -> String {
    format!("{}.png", photo.camera.name)
}

/// The picture of a photograph as a PNG, and its mask if a pixel is excluded: white pixels are used.
pub fn pictures(photo: &Photo) -> Result<(Vec<u8>, Option<Vec<u8>>), Error> {
    let (width, height) = (photo.camera.width_px as usize, photo.camera.height_px as usize);
    let png = |channels: usize, codes: Vec<u16>| {
        let raster =
            Raster { width, height, channels, largest: 255, codes, colour: None, ignored: Vec::new() };
        write(&raster, channels == 3, &[])
    };
    let colours = photo.pixels.iter().flat_map(|pixel| &pixel[..3]).map(|code| u16::from(*code)).collect();
    let masked = photo.pixels.iter().any(|pixel| pixel[3] == 0);
    let mask = || png(1, photo.pixels.iter().map(|pixel| if pixel[3] == 0 { 0 } else { 255 }).collect());
    Ok((png(3, colours)?, masked.then(mask).transpose()?))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::io::capture::{colmap, points};
    use crate::types::Point;

    /// The written model is read back. This test fails if `pose` returns the transform from camera to world.
    #[test]
    fn the_model_is_read_back() {
        let axes = DMat3::from_quat(DQuat::from_xyzw(0.2, -0.5, 0.3, 0.7).normalize());
        let eye = DVec3::new(1.0, -2.0, 0.5);
        let axes = [axes.x_axis, axes.y_axis, axes.z_axis];
        let camera = Camera { cx: 3.5, ..Camera::centred("a b", [6, 4], 5.0, axes, eye) };
        let mut pixels = vec![[1, 2, 3, 255]; 24];
        let whole = Photo { camera: camera.clone(), pixels: pixels.clone() };
        pixels[5][3] = 0;
        let photo = Photo { camera, pixels };
        let point = Point { position: [1.5, -2.0, 0.25], rgb: [1.0, 0.0, 0.2] };
        let photos = Photos { photos: vec![photo.clone()], points: vec![point] };
        let [cameras, images, found] = model(&photos).map(|(_, bytes)| bytes);
        let read = colmap::binary("m", &cameras, &images).expect("is valid");
        assert_eq!((read.len(), read[0].picture.as_str()), (1, "a b.png"));
        assert_eq!((read[0].width, read[0].height, read[0].lens), (6, 4, [5.0, 5.0, 3.5, 2.0]));
        assert!(read[0].distortion.is_none());
        let (now, before) = (read[0].world_from_camera.to_cols_array(), photo.camera.world_from_camera);
        assert!(now.iter().zip(before).all(|(a, b)| (a - b).abs() < 1e-12), "{now:?} {before:?}");
        assert_eq!(points::read("points3D.bin", &found).expect("is valid"), [point]);
        assert!(pictures(&photo).expect("encodes").1.is_some());
        assert!(pictures(&whole).expect("encodes").1.is_none());
    }
}
