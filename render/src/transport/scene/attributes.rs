//! Vertex attributes and textures at a point of an object.
//!
//! Texels are decoded to linear before bilinear interpolation. If the footprint of a ray covers many texels,
//! colours are read from a mipmap, interpolated between the two nearest levels. Only colours are filtered in
//! this way, because light is not linear in the other maps: the mean of a cut-out is not a cut-out, and the
//! mean of normals or roughness describes a different surface.

use glam::{Vec2, Vec3};
use scene::types::{ColourMap, Map, Object, Primitive, Texture, TextureRef, Wrap};

use super::mipmap::{Mipmap, Texels};
use crate::geometry::bvh::Hit;

/// Point of a primitive, for texture lookup.
#[derive(Clone, Copy)]
pub struct SurfacePoint<'a> {
    /// Object that contains the textures.
    pub object: &'a Object,
    /// Primitive that contains the triangle.
    pub primitive: &'a Primitive,
    /// Vertex indices of the triangle, in the order of the barycentric weights of the hit.
    pub corner: [u32; 3],
    /// The hit.
    pub hit: &'a Hit,
    /// Linear values of the 256 sRGB codes.
    pub decode: &'a [f32; 256],
    /// Mipmaps of the object's textures.
    pub mipmaps: &'a [Mipmap],
    /// Width of the footprint of the ray, as a share of the square root of twice the area of the triangle; 0
    /// for an infinitely thin ray.
    pub width: f32,
}

impl SurfacePoint<'_> {
    /// Interpolates a vertex attribute.
    pub fn blend<const N: usize>(&self, values: &[[f32; N]]) -> [f32; N] {
        let [a, b, c] = self.corner.map(|i| values[i as usize]);
        let (wb, wc) = (self.hit.b1, self.hit.b2);
        std::array::from_fn(|k| a[k] * (1.0 - wb - wc) + b[k] * wb + c[k] * wc)
    }

    /// Linear vertex colour and alpha; white if there are no vertex colours.
    pub fn vertex_colour(&self) -> [f32; 4] {
        if self.primitive.colours.is_empty() { [1.0; 4] } else { self.blend(&self.primitive.colours) }
    }

    /// Texture coordinates of the three vertices.
    pub fn coordinates(&self, set: u32) -> [Vec2; 3] {
        let uv = if set == 0 { &self.primitive.uv0 } else { &self.primitive.uv1 };
        self.corner.map(|i| uv.get(i as usize).copied().map_or(Vec2::ZERO, Vec2::from_array))
    }

    /// Value of a scalar parameter, multiplied by the given channel of its texture.
    pub fn number(&self, map: &Map, channel: usize) -> f32 {
        match map.texture {
            Some(texture) => map.factor * self.texture(Some(texture), Texels::Numbers)[channel],
            None => map.factor,
        }
    }

    /// Value of a colour parameter, multiplied by its texture.
    pub fn colour(&self, map: &ColourMap) -> Vec3 {
        let [r, g, b, _] = self.texture(map.texture, Texels::Colours);
        Vec3::from_array(map.factor) * Vec3::new(r, g, b)
    }

    /// Width of the triangle in texels of a texture: the square root of the area in texels of the
    /// parallelogram that two of its edges span.
    pub fn texels(&self, texture: TextureRef) -> f32 {
        let [a, b, c] = self.coordinates(texture.uv_set);
        let scale = texture.transform.map_or(1.0, |t| (t.scale[0] * t.scale[1]).abs());
        let all = self.object.textures.get(texture.texture as usize);
        let all = all.map_or(0.0, |image| image.width as f32 * image.height as f32);
        ((b - a).perp_dot(c - a).abs() * scale * all).sqrt()
    }

    /// Value of a texture at this point, with colours decoded to linear; white if there is no texture.
    pub fn texture(&self, texture: Option<TextureRef>, texels: Texels) -> [f32; 4] {
        let [r, g, b, alpha] = self.weighed(texture, texels);
        if texels != Texels::CoveredColours || alpha <= 0.0 {
            return [r, g, b, alpha];
        }
        [r / alpha, g / alpha, b / alpha, alpha]
    }

    /// Same as [`texture`](Self::texture), except that [`Texels::CoveredColours`] are premultiplied by alpha.
    fn weighed(&self, texture: Option<TextureRef>, texels: Texels) -> [f32; 4] {
        let Some(texture) = texture else { return [1.0; 4] };
        let Some(image) = self.object.textures.get(texture.texture as usize) else { return [1.0; 4] };
        if image.width == 0 || image.height == 0 {
            return [1.0; 4];
        }
        let [a, b, c] = self.coordinates(texture.uv_set);
        let mut uv = a * (1.0 - self.hit.b1 - self.hit.b2) + b * self.hit.b1 + c * self.hit.b2;
        if !uv.is_finite() {
            uv = Vec2::ZERO;
        }
        // Texels across the footprint, from the texel area of the triangle.
        let mut share = (b - a).perp_dot(c - a).abs();
        if let Some(t) = texture.transform {
            // KHR_texture_transform: a positive rotation turns the coordinates counter-clockwise with v down.
            let (sin, cos) = scene::math::num::sin_cos(f64::from(t.rotation));
            let (sin, cos) = (sin as f32, cos as f32);
            let (u, v) = (uv.x * t.scale[0], uv.y * t.scale[1]);
            uv = Vec2::new(cos * u + sin * v + t.offset[0], cos * v - sin * u + t.offset[1]);
            share *= (t.scale[0] * t.scale[1]).abs();
        }
        let across = self.width * (share * image.width as f32 * image.height as f32).sqrt();
        let Some(mipmap) = self.mipmaps.get(texture.texture as usize).filter(|_| across > 1.0) else {
            return self.between(image, texture, uv, texels);
        };
        // Linear interpolation between two mipmap levels: weight 1 at one texel per footprint, 0 at two.
        let (mut level, mut over) = (0, across);
        while over >= 2.0 && level < 31 {
            (level, over) = (level + 1, over * 0.5);
        }
        let over = over.min(2.0);
        let [fine, coarse] = [level, level + 1].map(|level| {
            self.between(mipmap.level(image, level, (texels, self.decode)), texture, uv, texels)
        });
        std::array::from_fn(|k| fine[k] * (2.0 - over) + coarse[k] * (over - 1.0))
    }

    /// Value of a mipmap level at texture coordinates, interpolated bilinearly.
    fn between(&self, image: &Texture, texture: TextureRef, uv: Vec2, texels: Texels) -> [f32; 4] {
        let fetch = |x: i64, y: i64| -> [f32; 4] {
            let x = wrap(x, i64::from(image.width), texture.sampler.wrap_u);
            let y = wrap(y, i64::from(image.height), texture.sampler.wrap_v);
            let first = (y * image.width as usize + x) * 4;
            let texel = [0, 1, 2, 3].map(|k| image.rgba[first + k]);
            let alpha = f32::from(texel[3]) / 255.0;
            std::array::from_fn(|k| match texels {
                Texels::CoveredColours if k < 3 => self.decode[texel[k] as usize] * alpha,
                Texels::Colours | Texels::Peaks if k < 3 => self.decode[texel[k] as usize],
                _ => f32::from(texel[k]) / 255.0,
            })
        };
        let (x, y) = (uv.x * image.width as f32, uv.y * image.height as f32);
        if texture.sampler.nearest {
            return fetch(x.floor() as i64, y.floor() as i64);
        }
        let (x, y) = (x - 0.5, y - 0.5);
        let (i, j) = (x.floor() as i64, y.floor() as i64);
        let (u, v) = (x - x.floor(), y - y.floor());
        let [p, q, r, s] = [fetch(i, j), fetch(i + 1, j), fetch(i, j + 1), fetch(i + 1, j + 1)];
        std::array::from_fn(|k| (p[k] * (1.0 - u) + q[k] * u) * (1.0 - v) + (r[k] * (1.0 - u) + s[k] * u) * v)
    }
}

/// Maps `index`, which may be outside the texture, to the index of a texel, by the given wrap mode. `size` is the
/// number of texels.
fn wrap(index: i64, size: i64, mode: Wrap) -> usize {
    let at = match mode {
        Wrap::Clamp => index.clamp(0, size - 1),
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::Mirror => {
            let at = index.rem_euclid(2 * size);
            if at < size { at } else { 2 * size - 1 - at }
        }
    };
    at as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_continue_as_asked() {
        let at = |mode| [-3, -1, 0, 3, 4, 9].map(|i| wrap(i, 4, mode));
        assert_eq!(at(Wrap::Repeat), [1, 3, 0, 3, 0, 1]);
        assert_eq!(at(Wrap::Mirror), [2, 0, 0, 3, 3, 1]);
        assert_eq!(at(Wrap::Clamp), [0, 0, 0, 3, 3, 3]);
    }
}
