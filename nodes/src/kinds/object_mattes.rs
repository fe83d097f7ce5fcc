//! `object-mattes`: the share of each pixel that each object covers.

use std::sync::Arc;

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes, Part, Sizes, ViewCount, Wired};
use render::transport::ground::capture_point::stand_in;
use render::transport::ground::standing::find_ground;
use render::transport::picture::camera_rays::CameraRays;
use render::transport::picture::shown_objects::shown_objects;
use render::transport::scene::frame::in_scene_frame;
use render::transport::scene::objects::Objects;
use render::transport::scene::receiver::Receiver;
use scene::types::layers::matching;
use scene::types::{Camera, Images, MatteView, Mattes, Mesh, Picture, Placed, Rig};

mod shares;

use shares::{Shares, spread};

engine::params! {
    /// Computes mattes of the objects, as Cryptomatte: for each pixel the objects that it shows, and the share of the
    /// pixel that each covers.
    ///
    /// `write-exr(mattes:)` writes them. The shares are those of the camera samples of `path-trace`, so they are
    /// antialiased and follow cut-outs and blended surfaces. The coverages of a pixel sum to the alpha of `object`, less
    /// the share that `front` covers. Pixels with alpha that no sample shows, because `composite` has blurred the object
    /// into them, take their shares from the nearest pixels. Wire `final.object` of a `composite` for mattes of the
    /// finished picture, or `trace.object` for those of the render.
    pub struct ObjectMattes {
        /// One name per object, in the order of the wires. Objects with the same name have one matte.
        names: Vec<String> = Vec::new(), other("[\"other\", \"cube\"]");
        /// Name of the Cryptomatte: its layers in the file are `CryptoObject00`, `CryptoObject01` and so on.
        layer: String = "CryptoObject".to_owned(), other("\"Props\"");
        /// Number of samples per pixel. With at least as many as `path-trace` takes, every pixel that shows an object has
        /// shares of its own.
        samples: u32 = 256, range(1, 65_536), other("1"), knob(Samples, "4", "16", "64", "1024");
        /// Maximum number of objects per pixel. Those with the least coverage are left out, and counted.
        ranks: u32 = 6, range(1, 64), other("1"), inert("a pixel of one object");
        /// Error of the mesh where objects rest, as in `path-trace`.
        contact_metres: Option<f64> = None, range(0.0, 10.0), unit("m"), other("0.5"), inert("changes alpha, which comes from `object`");
    }
}
engine::inputs! {
    /// Inputs of [`ObjectMattes`].
    pub struct In {
        /// The rendered objects, with alpha: the output `object` of `path-trace`, `denoise` or `composite`.
        object: Arc<Images>,
        /// The objects, as they are wired to `path-trace`.
        objects: Vec<Arc<Placed>>,
        /// The cameras.
        rig: Arc<Rig>,
        /// The mesh of the place, which hides the objects behind it. Leave it out if `surroundings: Paper` traces them.
        receiver: Option<Arc<Mesh>>,
        /// The part of the background that lies in front of the objects, with alpha, as it is wired to `composite`.
        front: Option<Arc<Images>>,
    }
}
engine::outputs! {
    /// Outputs of [`ObjectMattes`].
    pub struct Out {
        /// The mattes of each view.
        mattes: Arc<Mattes>,
    }
}

impl Kind for ObjectMattes {
    const NAME: &'static str = "object-mattes";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] =
        &[ContextField::MetresPerUnit, ContextField::Seed, ContextField::Up];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        let word = p.layer.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        if !word || p.layer.is_empty() || p.layer.ends_with(|c: char| c.is_ascii_digit()) {
            let what = format!("the name `{}` of the Cryptomatte cannot be written", p.layer);
            let hint = "use letters, digits and `_`, and end with a letter, such as `CryptoObject`";
            return Err(NodeError::new(what).at("layer").hint(hint));
        }
        if p.names.iter().any(String::is_empty) {
            let error = NodeError::new("the name of an object is empty").at("names");
            return Err(error.hint("give each object the name by which it is to be picked"));
        }
        Ok(())
    }

    fn check_wires(p: &Self, wired: &Wired) -> Result<(), NodeError> {
        p.check_names(wired.of("objects").len())
    }

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["object"])
    }

    fn estimate(p: &Self, inputs: &In) -> Cost {
        let size = |picture: &Picture| picture.size().0 as u64 * picture.size().1 as u64;
        let pixels = inputs.object.0.iter().map(|view| size(&view.picture)).sum();
        let triangles: usize =
            inputs.objects.iter().flat_map(|o| &o.object.primitives).map(|p| p.triangles.len()).sum();
        let receiver = inputs.receiver.as_ref().map_or(0, |mesh| mesh.triangles.len());
        Cost::of([(pixels, 64 + 8 * u64::from(p.ranks)), ((triangles + receiver) as u64, 300)])
    }

    fn work(p: &Self, sizes: &Sizes) -> f64 {
        sizes.of("object") * f64::from(p.samples)
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        p.check_names(inputs.objects.len())?;
        let Some(first) = inputs.rig.cameras.first() else {
            return Err(NodeError::new("the rig has no camera").at("rig"));
        };
        let origin = first.eye();
        let none = Arc::default();
        let mesh = inputs.receiver.as_ref().unwrap_or(&none);
        let part = Part { name: "receiver", version: 1, inputs: &["receiver"] };
        let new = || Receiver::new_in(mesh, origin, cx);
        let receiver = cx.in_memory(part, &origin.to_array(), Receiver::bytes, new)?;
        let mut objects = Objects::new(Some(&receiver), &inputs.objects, origin)?;
        let eye = in_scene_frame(stand_in(&receiver, &inputs.rig.cameras, origin).eye(), origin);
        let [_, _, up] = scene::math::equirect::axes(cx.up());
        find_ground(&mut objects, &receiver, origin, eye, (up, cx.metres_per_unit()), p.contact_metres);
        let groups = Groups::of(&p.names);
        let mut mattes = Mattes { layer: p.layer.clone(), names: groups.names.clone(), views: Vec::new() };
        let mut counts = Counts::default();
        for view in &inputs.object.0 {
            let (width, height, _) = view.picture.size();
            let camera = camera_of(&inputs.rig, &view.name, (width, height))?;
            let camera_rays = CameraRays::new(camera, origin, cx.seed(), &objects.ground, 1);
            let found = p.trace(&groups, (&objects, &receiver), &camera_rays, cx)?;
            let mut alpha = alpha_of(&view.picture, "object")?;
            if let Some(front) = &inputs.front {
                let front = alpha_of(matching(front, "front", &view.name, (width, height))?, "front")?;
                alpha.iter_mut().zip(front).for_each(|(alpha, front)| *alpha *= 1.0 - front);
            }
            let (matte, own) = p.finish(found, &alpha, (&view.name, width, height));
            counts.add(own);
            mattes.views.push(matte);
        }
        Ok((Out { mattes: Arc::new(mattes) }, counts.notes()))
    }
}

impl ObjectMattes {
    /// Checks that each object has a name.
    fn check_names(&self, objects: usize) -> Result<(), NodeError> {
        if self.names.len() == objects {
            return Ok(());
        }
        let named = self.names.len();
        let what = format!("`names` must list one name per object (names: {named}, objects: {objects})");
        Err(NodeError::new(what).at("names").hint("name every object, in the order of the wires"))
    }

    /// Shares of the objects among the samples of each pixel, row by row.
    fn trace(
        &self,
        groups: &Groups,
        scene: (&Objects, &Receiver),
        camera_rays: &CameraRays<'_>,
        cx: &Context,
    ) -> Result<Vec<Shares>, NodeError> {
        let (width, height) = (camera_rays.camera.width_px, camera_rays.camera.height_px);
        let rows = cx.for_each_tile(height as usize, |y| {
            let mut rays = 0;
            let pixel = |x| {
                let counts = shown_objects(scene, camera_rays, (x, y as u32), self.samples, &mut rays);
                Shares::of(
                    counts.into_iter().map(|(object, n)| (groups.of_object[object as usize], f64::from(n))),
                )
            };
            let row: Vec<Shares> = (0..width).map(pixel).collect();
            (row, rays)
        })?;
        let rays = rows.iter().map(|(_, rays)| rays).sum();
        cx.count("rays", rays);
        cx.count("camera_rays", rays);
        Ok(rows.into_iter().flat_map(|(row, _)| row).collect())
    }

    /// The mattes of a view from the shares of its pixels and the alpha that the coverages of each pixel sum to.
    fn finish(
        &self,
        mut shares: Vec<Shares>,
        alpha: &[f64],
        (name, width, height): (&str, usize, usize),
    ) -> (MatteView, Counts) {
        let solid = || shares.iter().zip(alpha).filter(|(_, alpha)| **alpha > SOLID);
        let mut counts = Counts { solid: solid().count() as u64, ..Counts::default() };
        counts.unseen = solid().filter(|(own, _)| own.is_empty()).count() as u64;
        [counts.taken, counts.empty] = spread(&mut shares, width, |pixel| alpha[pixel] > 0.0);
        let ranks = self.ranks as usize;
        let mut indices = vec![0; width * height * ranks];
        let mut coverages = vec![0.0; width * height * ranks];
        for (pixel, (own, alpha)) in shares.iter().zip(alpha).enumerate() {
            let pairs = own.ranked(*alpha);
            counts.cut += u64::from(pairs.len() > ranks);
            for (rank, (index, coverage)) in pairs.into_iter().take(ranks).enumerate() {
                (indices[pixel * ranks + rank], coverages[pixel * ranks + rank]) = (index, coverage);
            }
        }
        (MatteView { name: name.to_owned(), width, height, ranks, indices, coverages }, counts)
    }
}

/// Alpha above which a pixel is inside an object. A blur leaves less in pixels that the object does not reach by itself.
const SOLID: f64 = 0.9;
/// Maximum share of the pixels inside objects in which no sample shows an object, without a warning. With other objects
/// or another rig it is about one half or more.
const MOST_UNSEEN: f64 = 0.05;

/// Numbers of pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Counts {
    /// Pixels inside objects, by their alpha.
    solid: u64,
    /// Pixels inside objects in which no sample shows one.
    unseen: u64,
    /// Pixels with alpha in which no sample shows an object, and that took the shares of others.
    taken: u64,
    /// Pixels with alpha that no object is near.
    empty: u64,
    /// Pixels that show more objects than there are ranks.
    cut: u64,
}

impl Counts {
    fn add(&mut self, view: Self) {
        self.solid += view.solid;
        self.unseen += view.unseen;
        self.taken += view.taken;
        self.empty += view.empty;
        self.cut += view.cut;
    }

    fn notes(&self) -> Notes {
        let mut notes = Notes::none();
        if self.unseen as f64 > MOST_UNSEEN * self.solid as f64 {
            let text = format!(
                "no sample shows an object in {} of the {} pixels inside objects, so the mattes are wrong there; wire all \
                 objects of the trace, its rig and its `object`",
                self.unseen, self.solid
            );
            notes.warning("mattes-disagree", text);
        }
        if self.taken > 0 {
            let what =
                "pixels with alpha in which no sample shows an object took the shares of their neighbours: ";
            notes.decision("mattes-spread", format!("{what}{}", self.taken));
        }
        let empty = "of the pixels with alpha are in a view in which no sample shows an object, so they have no matte; \
                     wire the objects and the rig of the trace, or raise `samples`";
        notes.count("mattes-empty", self.empty, empty);
        let cut = "of the pixels show more objects than `ranks`; those with the least coverage are left out";
        notes.count("mattes-cut", self.cut, cut);
        notes
    }
}

/// Objects by name.
struct Groups {
    /// The names, each once.
    names: Vec<String>,
    /// For each object, the index of its name.
    of_object: Vec<u32>,
}

impl Groups {
    fn of(all: &[String]) -> Self {
        let mut names: Vec<String> = Vec::new();
        let of_object = all.iter().map(|name| {
            let at = names.iter().position(|known| known == name).unwrap_or(names.len());
            if at == names.len() {
                names.push(name.clone());
            }
            at as u32
        });
        let of_object = of_object.collect();
        Self { names, of_object }
    }
}

/// The camera of a view. A rig of one camera belongs to every view.
fn camera_of<'a>(rig: &'a Rig, view: &str, size: (usize, usize)) -> Result<&'a Camera, NodeError> {
    let named = rig.cameras.iter().find(|camera| camera.name == view);
    let only = || rig.cameras.first().filter(|_| rig.cameras.len() == 1);
    let hint = "wire the rig that `object` was rendered with";
    let Some(camera) = named.or_else(only) else {
        let there: Vec<&str> = rig.cameras.iter().map(|camera| camera.name.as_str()).collect();
        let what = format!("`rig` has no camera `{view}`; its cameras are {}", there.join(", "));
        return Err(NodeError::new(what).at("rig").hint(hint));
    };
    if (camera.width_px as usize, camera.height_px as usize) == size {
        return Ok(camera);
    }
    let own = format!("{}x{}", camera.width_px, camera.height_px);
    let what = format!("`{view}` of `object` is {}x{} pixels, but its camera has {own}", size.0, size.1);
    Err(NodeError::new(what).at("object").hint(hint))
}

/// Alpha of each pixel, limited to 0 to 1.
fn alpha_of(picture: &Picture, port: &'static str) -> Result<Vec<f64>, NodeError> {
    let (_, _, channels) = picture.size();
    if !matches!(channels, 2 | 4) {
        let what = format!("`{port}` has no alpha channel (channels: {channels})");
        return Err(NodeError::new(what).at(port).hint("wire a picture with alpha"));
    }
    let last = picture.samples().iter().skip(channels - 1).step_by(channels);
    // NaN becomes 0.
    let limited = |alpha: &f32| if *alpha > 0.0 { f64::from(alpha.min(1.0)) } else { 0.0 };
    Ok(last.map(limited).collect())
}

#[cfg(test)]
mod tests;
