//! Types of the values that nodes pass to each other.

mod environment;
pub mod frame;
mod image;
pub mod layers;
mod lens;
mod material;
mod mattes;
mod mesh;
mod object;
mod panorama;
mod photos;
pub mod pick;
mod pose;
mod report;
mod rig;
mod splats;
pub mod view;

pub use environment::{Environment, Light};
pub use image::{Data, Encoding, Image, Images, Linear, NamedImage, Picture, Srgb};
pub use lens::{Lens, LensModel};
pub use material::{
    AlphaMode, Anisotropy, Clearcoat, ColourMap, DiffuseTransmission, Iridescence, Map, Material, NormalMap,
    Sampler, Sheen, Specular, Texture, TextureRef, TextureTransform, Wrap,
};
pub use mattes::{MatteView, Mattes};
pub use mesh::grouped;
pub use mesh::{Gloss, Mesh};
pub use object::{Object, Placed, Primitive};
pub use panorama::{Brackets, Panorama, Taken};
pub use photos::{Photo, Photos, Point};
pub use pose::Pose;
pub use report::{Cell, Report, Table};
pub use rig::{Camera, Rig};
pub use splats::tagged;
pub use splats::{SplatEncoding, Splats, View, Views};
