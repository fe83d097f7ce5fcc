//! The numbers of the file of a plate, for pixels that nothing has changed.

use std::sync::Arc;

use engine::NodeError;
use scene::types::layers::matching;
use scene::types::{Image, Images, Linear, Picture};

/// A plate in linear light, and the numbers of its file, both as pixels of three or four samples.
pub(super) struct Plate<'a> {
    linear: &'a Image<Linear>,
    stored: &'a Picture,
}

impl<'a> Plate<'a> {
    /// The plate of a view. Both pictures must have the size and the same number of channels.
    pub(super) fn of(
        view: &str,
        [plate, stored]: [&'a Arc<Images>; 2],
        size: (usize, usize),
    ) -> Result<Self, NodeError> {
        let linear = match matching(plate, "plate", view, size)? {
            Picture::Linear(linear) if linear.channels >= 3 => linear,
            other => {
                let what = format!(
                    "`plate` has the encoding `{}` (channels: {}), but only colours in linear light return exactly",
                    other.encoding(),
                    other.size().2
                );
                return Err(NodeError::new(what).at("plate"));
            }
        };
        let stored = matching(stored, "stored", view, size)?;
        let (of_plate, of_stored) = (linear.channels, stored.size().2);
        if of_stored != of_plate {
            let what = format!("`stored` has {of_stored} channels, but `plate` has {of_plate}");
            return Err(NodeError::new(what).at("stored").hint(STORED));
        }
        Ok(Self { linear, stored })
    }

    /// The stored colours of the pixel at an index, if the plate has the same colours as a picture there.
    pub(super) fn colours(&self, at: usize, pixel: &[f32]) -> Option<[f32; 3]> {
        let from = at * self.linear.channels;
        let samples = &self.stored.samples()[from..from + 3];
        (pixel.len() >= 3 && pixel[..3] == self.linear.samples[from..from + 3])
            .then(|| [samples[0], samples[1], samples[2]])
    }
}

/// Requirement on the input `stored`, for messages.
pub(super) const STORED: &str = "`stored` is a `LoadImage` of the file of the plate with `encoding: Data`, and its numbers must be in the space of `encoding`";

/// Largest difference between stored colours and those that are converted from the working space, as a share of the
/// largest component.
pub(super) const ROUNDING: f32 = 1e-5;
