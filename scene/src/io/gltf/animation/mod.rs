//! Animations: the transforms and morph weights of the nodes of a file at a time (glTF 2.0, section 3.11).

mod curve;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use engine::{NodeError, Notes};
use serde_json::Value;

use super::document::document;
use super::file::File;
use crate::error::Error;
use curve::{Curve, Interpolation};

engine::choices! {
    /// Treatment of times after the end of an animation.
    pub enum AfterEnd {
        /// Such a time is an error.
        Refuse,
        /// The last pose is kept.
        Hold,
        /// The animation starts again.
        Repeat,
    }
}

/// A time in an animation.
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a> {
    /// Name of the animation. An animation without a name is named by its index.
    pub clip: &'a str,
    /// Time in seconds, at least 0.
    pub seconds: f64,
    /// Treatment of times after the end of the animation.
    pub after_end: AfterEnd,
}

/// Properties of a node that an animation changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Property {
    Translation,
    Rotation,
    Scale,
    Weights,
}

impl Property {
    fn of(path: &str) -> Option<Self> {
        Some(match path {
            "translation" => Self::Translation,
            "rotation" => Self::Rotation,
            "scale" => Self::Scale,
            "weights" => Self::Weights,
            _ => return None,
        })
    }

    /// Name of the field of a node that holds the property.
    fn field(self) -> &'static str {
        match self {
            Self::Translation => "translation",
            Self::Rotation => "rotation",
            Self::Scale => "scale",
            Self::Weights => "weights",
        }
    }

    /// Number of components. `None` for morph weights, whose number depends on the mesh.
    fn width(self) -> Option<usize> {
        match self {
            Self::Translation | Self::Scale => Some(3),
            Self::Rotation => Some(4),
            Self::Weights => None,
        }
    }
}

/// The names of the animations of a file, in order. An animation without a name is named by its index.
pub fn names(json: &Value) -> Vec<String> {
    let animations = json["animations"].as_array().into_iter().flatten().enumerate();
    animations.map(|(index, a)| a["name"].as_str().map_or_else(|| index.to_string(), str::to_owned)).collect()
}

/// The curves of an animation by node and property.
type Curves = BTreeMap<(usize, Property), Curve>;

impl File {
    /// Moves the nodes of the file to their transforms and morph weights at a time of an animation.
    ///
    /// # Errors
    /// If the file has no such animation, if the time is after its end and [`AfterEnd::Refuse`] is set, or if the
    /// animation is not valid. The error names the parameter `clip` or `time_s`.
    pub fn pose(
        &mut self,
        moment: &Moment<'_>,
        buffers: &[Vec<u8>],
        notes: &mut Notes,
    ) -> Result<(), NodeError> {
        let names = names(&self.json);
        let mut equal =
            names.iter().enumerate().filter(|(_, name)| *name == moment.clip).map(|(index, _)| index);
        let Some(index) = equal.next() else {
            let known = match names.as_slice() {
                [] => "it has no animations".to_owned(),
                names => format!("its animations are {}", listed(names)),
            };
            let what = format!("`{}` has no animation `{}`; {known}", self.name, moment.clip);
            return Err(NodeError::new(what).at("clip"));
        };
        let twins = equal.count();
        if twins > 0 {
            let what = format!(
                "the first animation `{}` of `{}` is played; other animations have the same name (count: {twins})",
                moment.clip, self.name
            );
            notes.warning("clip-not-unique", what);
        }
        let (curves, ignored) = self.curves(index, buffers)?;
        let end = curves.values().map(Curve::end).fold(0.0, f64::max);
        let seconds = time(moment, end)?;
        for ((node, property), curve) in &curves {
            let mut value = curve.at(seconds);
            if *property == Property::Rotation {
                normalize(&mut value);
            }
            self.json["nodes"][*node][property.field()] = Value::from(value);
        }
        self.document = document(&self.name, &mut self.json)?;
        let text =
            format!("`{}` is played at {seconds} s of {end} s (channels: {})", moment.clip, curves.len());
        notes.decision("animation", text);
        notes.count(
            "animation-ignored",
            ignored,
            "of the channels of the animation change properties other than transforms and morph weights, and are ignored",
        );
        Ok(())
    }

    /// The curves of an animation by node and property, and the number of channels that are not supported.
    fn curves(&self, index: usize, buffers: &[Vec<u8>]) -> Result<(Curves, u64), Error> {
        let animation = &self.json["animations"][index];
        let (mut curves, mut ignored) = (BTreeMap::new(), 0);
        for (channel, entry) in animation["channels"].as_array().into_iter().flatten().enumerate() {
            let bad = |what: &str| {
                Error::format(&self.name, format!("channel {channel} of animation {index} {what}"))
            };
            let target = &entry["target"];
            let property = target["path"].as_str().and_then(Property::of);
            let (Some(node), Some(property)) = (target["node"].as_u64(), property) else {
                // The specification says that a channel without a node is ignored. Pointers are an extension.
                ignored += 1;
                continue;
            };
            let node = node as usize;
            let held =
                self.json["nodes"].get(node).ok_or_else(|| bad("animates a node that does not exist"))?;
            if property != Property::Weights && held.get("matrix").is_some() {
                return Err(bad(
                    "animates a node that has a matrix instead of a translation, rotation and scale",
                ));
            }
            let sampler = entry["sampler"].as_u64().unwrap_or(u64::MAX) as usize;
            let sampler =
                animation["samplers"].get(sampler).ok_or_else(|| bad("has a sampler that does not exist"))?;
            let interpolation = match sampler["interpolation"].as_str() {
                None | Some("LINEAR") if property == Property::Rotation => Interpolation::Spherical,
                None | Some("LINEAR") => Interpolation::Linear,
                Some("STEP") => Interpolation::Step,
                Some("CUBICSPLINE") => Interpolation::Cubic,
                Some(other) => return Err(bad(&format!("has the unknown interpolation `{other}`"))),
            };
            let accessor = |name: &str| {
                let index = sampler[name].as_u64().unwrap_or(u64::MAX);
                let found = self.document.accessors().nth(usize::try_from(index).unwrap_or(usize::MAX));
                let found = found.ok_or_else(|| bad(&format!("has no accessor `{name}`")))?;
                self.numbers(&found, buffers)
            };
            let (times, values) = (accessor("input")?, accessor("output")?);
            let curve = Curve::new(times.values, values.values, property.width(), interpolation)
                .map_err(|what| bad(&what))?;
            if let (Property::Weights, Some(targets)) = (property, self.morph_targets(held))
                && curve.width() != targets
            {
                let what = format!(
                    "has {} morph weights per key, but the mesh has {targets} morph targets",
                    curve.width()
                );
                return Err(bad(&what));
            }
            curves.insert((node, property), curve);
        }
        Ok((curves, ignored))
    }

    /// Number of morph targets of the mesh of a node. `None` if the node has no mesh.
    fn morph_targets(&self, node: &Value) -> Option<usize> {
        let mesh = self.json["meshes"].get(node["mesh"].as_u64()? as usize)?;
        Some(mesh["primitives"][0]["targets"].as_array().map_or(0, Vec::len))
    }
}

/// Checks that a time is given only together with an animation.
pub fn check_clip(clip: Option<&str>, seconds: f64) -> Result<(), NodeError> {
    if clip.is_none() && seconds > 0.0 {
        let error = NodeError::new("a time has no effect without an animation").at("time_s");
        return Err(error.hint("set `clip` to the name of an animation of the file"));
    }
    Ok(())
}

/// The time in the animation, between 0 and `end`.
fn time(moment: &Moment<'_>, end: f64) -> Result<f64, NodeError> {
    let (seconds, clip) = (moment.seconds, moment.clip);
    // Exporters store times as f32, so the last frame may lie above the end by a rounding error.
    let is_after = seconds > end + 1e-6 * end;
    match moment.after_end {
        _ if !is_after => Ok(seconds.min(end)),
        AfterEnd::Hold => Ok(end),
        AfterEnd::Repeat if end > 0.0 => Ok(seconds - (seconds / end).floor() * end),
        AfterEnd::Repeat => Ok(0.0),
        AfterEnd::Refuse => {
            let what = format!(
                "animation `{clip}` ends at {end} s, before {seconds} s: set `after_end: Hold` to keep its last pose, or \
                 `after_end: Repeat` to start it again"
            );
            Err(NodeError::new(what).at("time_s"))
        }
    }
}

/// Scales a quaternion to length 1. A quaternion of length 0 becomes the identity.
fn normalize(q: &mut [f64]) {
    let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() {
        q.iter_mut().for_each(|c| *c /= length);
    } else if let [x, y, z, w] = q {
        (*x, *y, *z, *w) = (0.0, 0.0, 0.0, 1.0);
    }
}

/// The first names of a list, quoted.
pub fn listed(names: &[String]) -> String {
    const MOST: usize = 8;
    let quoted: Vec<String> = names.iter().take(MOST).map(|name| format!("`{name}`")).collect();
    let more = names.len().saturating_sub(MOST);
    if more > 0 { format!("{} and {more} more", quoted.join(", ")) } else { quoted.join(", ") }
}
