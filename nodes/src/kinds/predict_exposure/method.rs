//! Methods of estimating hidden light, as written in a graph file.

use std::fmt::Formatter;

use engine::{Context, InputFile, NodeError, NotCanonical, Notes, ParamType, Role, canonical};
use scene::types::Panorama;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::kontext::Kontext;
use super::photographs::Photographs;

/// Method of estimating hidden light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Method {
    /// A regression on the visible light estimates the total amount of hidden light, small networks distribute it
    /// over the clipped pixels, and a regression estimates its colour.
    Learned,
    /// A regression on nine numbers (size, height, surroundings, shape) estimates the mean brightness of each
    /// connected clipped region.
    Region,
    /// Lights given by the user; other clipped pixels stay clipped.
    Manual {
        /// Lights, each given by four numbers: azimuth (degrees clockwise from forward, seen from above; -360 to
        /// 360), elevation (degrees above the horizon; -90 to 90), radius of the disc in which it acts on clipped
        /// pixels (degrees; above 0 to 180), and the number of stops by which these pixels are brighter than they
        /// appear (0 to 24). The narrowest light that covers a pixel is used.
        #[serde(deserialize_with = "emitters")]
        emitters: Vec<[f64; 4]>,
    },
    /// Gain measured from darker photographs of the same scene. `evs` then gives the exposures at which the
    /// photographs were taken.
    Photographs {
        /// Files, one for each of `evs` in the same order, each as large as the panorama. They are rotated like the
        /// panorama. OpenEXR and Radiance files are never clipped.
        files: Vec<InputFile>,
    },
    /// No estimate: clipped pixels stay clipped.
    Skip,
    /// The method of the paper: Flux.1 Kontext, a diffusion model, with a LoRA that repeatedly reduces the exposure
    /// by three stops. Needs the feature `learned`, and weights that the user supplies.
    FluxKontext {
        /// Flux.1 Kontext: safetensors in the layout of its authors or of `diffusers` (or its first shard), or
        /// GGUF.
        transformer: InputFile,
        /// Autoencoder: `ae.safetensors`, or the autoencoder file of `diffusers`.
        vae: InputFile,
        /// Encoded prompt: tensors `t5` and `clip`.
        prompt: InputFile,
        /// LoRA for the exposure.
        lora: InputFile,
        /// Strength of the LoRA, from 0 to 4; 1 is the strength it was trained with.
        #[serde(default = "strength")]
        strength: f64,
        /// Number of denoising steps for each exposure, from 1 to 200.
        #[serde(default = "steps")]
        steps: u32,
        /// Guidance scale: how strongly the model follows its prompt, from 0 to 20.
        #[serde(default = "guidance")]
        guidance: f64,
        /// Largest width at which the model works, from 64 to 4096 pixels, rounded down to a multiple of 32.
        #[serde(default = "width_px")]
        width_px: u32,
        /// True to compute each step twice, the second time with the panorama rotated by half a turn, so that no
        /// seam is visible.
        #[serde(default = "seamless")]
        seamless: bool,
        /// Seed of the initial noise.
        #[serde(default)]
        seed: u64,
    },
}

/// Reads the list of lights, each a list of four numbers. The error for a wrong list describes the problem.
fn emitters<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<[f64; 4]>, D::Error> {
    let emitters = Vec::<Emitter>::deserialize(from)?;
    Ok(emitters.into_iter().map(|Emitter(numbers)| numbers).collect())
}

struct Emitter([f64; 4]);

impl<'de> Deserialize<'de> for Emitter {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Numbers;
        impl<'de> Visitor<'de> for Numbers {
            type Value = Emitter;

            fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
                f.write_str("an emitter (azimuth, elevation, radius, stops)")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Emitter, A::Error> {
                let (mut numbers, mut count) = ([0.0; 4], 0);
                while let Some(number) = list.next_element::<f64>().map_err(|_| {
                    let which =
                        ["azimuth", "elevation", "radius", "stops"].get(count).unwrap_or(&"fifth value");
                    A::Error::custom(format_args!("the {which} of an emitter is not a number"))
                })? {
                    if let Some(place) = numbers.get_mut(count) {
                        *place = number;
                    }
                    count += 1;
                }
                if count == 4 { Ok(Emitter(numbers)) } else { Err(A::Error::invalid_length(count, &self)) }
            }
        }
        from.deserialize_tuple(4, Numbers)
    }
}

fn strength() -> f64 {
    1.0
}

fn steps() -> u32 {
    28
}

fn guidance() -> f64 {
    2.5
}

fn width_px() -> u32 {
    1024
}

fn seamless() -> bool {
    true
}

impl Method {
    /// Reads the photographs. `None` unless the method is `Photographs`.
    pub(super) fn photographs(
        &self,
        evs: &[f64],
        pano: &Panorama,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Option<Photographs>, NodeError> {
        let Self::Photographs { files } = self else { return Ok(None) };
        Photographs::read(files, evs, pano, notes, cx).map(Some)
    }

    /// The parameters of the diffusion model; `None` unless the method is `FluxKontext`.
    pub(super) fn kontext(&self) -> Option<Kontext<'_>> {
        let Self::FluxKontext {
            transformer,
            vae,
            prompt,
            lora,
            strength,
            steps,
            guidance,
            width_px,
            seamless,
            seed,
        } = self
        else {
            return None;
        };
        Some(Kontext {
            transformer,
            vae,
            prompt,
            lora,
            strength: *strength,
            steps: *steps,
            guidance: *guidance,
            width_px: *width_px,
            seamless: *seamless,
            seed: *seed,
        })
    }
}

impl ParamType for Method {
    const ROLE: Role = Role::Input;

    fn describe() -> String {
        "Learned | Region | Manual(emitters: [(azimuth, elevation, radius, stops)]) | Photographs(files: [path, ..]) | Skip | FluxKontext(transformer: path, vae: path, prompt: path, lora: path, strength: 1.0, \
         steps: 28, guidance: 2.5, width_px: 1024, seamless: true, seed: 0)"
            .to_owned()
    }

    fn choices() -> Vec<(&'static str, &'static str)> {
        vec![
            (
                "Learned",
                "A regression on the visible light estimates the total amount of hidden light, small networks \
                 distribute it over the clipped pixels, and a regression estimates its colour.",
            ),
            (
                "Region",
                "A regression on nine numbers (size, height, surroundings, shape) estimates the mean brightness of each \
                 connected clipped region.",
            ),
            (
                "Manual",
                "Lights given by the user, each as four numbers: azimuth (degrees clockwise from forward, seen from above; \
                 -360 to 360), elevation (degrees above the horizon; -90 to 90), radius of the disc in which it acts on \
                 clipped pixels (degrees; above 0 to 180), and the number of stops by which these pixels are brighter than \
                 they appear (0 to 24). The narrowest light that covers a pixel is used; pixels that no light covers stay \
                 clipped.",
            ),
            (
                "Photographs",
                "The gain is measured from darker photographs of the same scene, one file for each of `evs`, each as large \
                 as the panorama. They are rotated with the panorama. OpenEXR and Radiance files are not clipped.",
            ),
            ("Skip", "No estimate: clipped pixels stay clipped."),
            (
                "FluxKontext",
                "A diffusion model as in the paper, with weights that you supply (needs the feature `learned`). `strength` of \
                 the LoRA is 0 to 4, `steps` for each exposure 1 to 200, `guidance` 0 to 20, and `width_px`, the largest \
                 width at which the model works, 64 to 4096.",
            ),
        ]
    }

    /// Text for the cache key. Files are identified by their content, which the engine adds. The tensor
    /// library does not compute the same bits on every machine, so its name is part of the key.
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        match self.kontext() {
            None if matches!(self, Self::Photographs { .. }) => Ok(Some("Photographs".to_owned())),
            None => canonical(self).map(Some),
            Some(Kontext { strength, steps, guidance, width_px, seamless, seed, .. }) => {
                let numbers = canonical(&(strength, steps, guidance, width_px, seamless, seed))?;
                Ok(Some(format!("FluxKontext{numbers} by candle 0.11 in f32")))
            }
        }
    }

    fn paths(&self) -> Vec<&str> {
        match (self, self.kontext()) {
            (Self::Photographs { files }, _) => files.iter().map(|file| file.0.as_str()).collect(),
            (_, Some(kontext)) => kontext.files().map(|file| file.0.as_str()).to_vec(),
            _ => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::IntoDeserializer;
    use serde::de::value::{Error, SeqDeserializer};

    // This test fails if the length is not checked, or if the error names the wrong number.
    #[test]
    fn a_list_that_is_no_emitter_is_reported_what_it_lacks() {
        fn read<T: IntoDeserializer<'static, Error>>(list: Vec<T>) -> Result<[f64; 4], String> {
            let list = SeqDeserializer::<_, Error>::new(list.into_iter());
            Emitter::deserialize(list).map(|Emitter(numbers)| numbers).map_err(|error| error.to_string())
        }
        assert_eq!(read(vec![1.0, 2.0, 3.5, 4.0]), Ok([1.0, 2.0, 3.5, 4.0]));
        for count in [0, 3, 5] {
            let why = read(vec![1.0; count]).expect_err("an error");
            let wanted =
                format!("invalid length {count}, expected an emitter (azimuth, elevation, radius, stops)");
            assert_eq!(why, wanted);
        }
        assert_eq!(read(vec!["nan"]).expect_err("an error"), "the azimuth of an emitter is not a number");
    }
}
