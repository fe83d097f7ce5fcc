//! Names of the parts of the transformer in weights files.
//!
//! This crate uses the names that the model's authors use in their own files and in GGUF files
//! (`double_blocks.0.img_attn.qkv`). In the layout of `diffusers`, parts have other names, and some matrices are
//! split.

/// The tensors in a file that form one part of the transformer when their rows are concatenated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pieces {
    /// Names of modules, without `.weight` or `.bias`.
    pub modules: Vec<String>,
    /// True if the file contains the first and the second half of the rows in swapped order. In the last
    /// modulation, `diffusers` stores first the scales and then the shifts; the authors store first the shifts.
    pub swapped: bool,
}

/// The layout of a weights file: how its tensors are named and split.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// The names of the model's authors, each preceded by `prefix` (`model.diffusion_model.` in files that contain
    /// several models).
    Original {
        /// Prefix of each name.
        prefix: &'static str,
    },
    /// The names of `diffusers`.
    Diffusers,
}

impl Layout {
    /// The tensors of a file that together form the part `module`.
    pub fn pieces(self, module: &str) -> Pieces {
        match self {
            Self::Original { prefix } => {
                Pieces { modules: vec![format!("{prefix}{module}")], swapped: false }
            }
            Self::Diffusers => diffusers(module),
        }
    }

    /// The name of the tensor with the scales of a norm.
    pub fn scale(self, module: &str) -> String {
        match self {
            Self::Original { prefix } => format!("{prefix}{module}.scale"),
            Self::Diffusers => format!("{}.weight", diffusers(module).modules[0]),
        }
    }
}

/// The modules of `diffusers` that correspond to the part that the authors call `module`.
fn diffusers(module: &str) -> Pieces {
    let whole = |name: String| Pieces { modules: vec![name], swapped: false };
    let several = |block: &str, parts: &[&str]| Pieces {
        modules: parts.iter().map(|part| format!("{block}.{part}")).collect(),
        swapped: false,
    };
    let mut levels = module.splitn(3, '.');
    let (first, second, rest) =
        (levels.next().unwrap_or(""), levels.next().unwrap_or(""), levels.next().unwrap_or(""));
    match (first, rest) {
        ("double_blocks", part) => {
            let block = format!("transformer_blocks.{second}");
            match part {
                "img_attn.qkv" => several(&block, &["attn.to_q", "attn.to_k", "attn.to_v"]),
                "txt_attn.qkv" => several(&block, &["attn.add_q_proj", "attn.add_k_proj", "attn.add_v_proj"]),
                _ => whole(format!("{block}.{}", renamed(part, &DOUBLE))),
            }
        }
        ("single_blocks", part) => {
            let block = format!("single_transformer_blocks.{second}");
            match part {
                "linear1" => several(&block, &["attn.to_q", "attn.to_k", "attn.to_v", "proj_mlp"]),
                _ => whole(format!("{block}.{}", renamed(part, &SINGLE))),
            }
        }
        _ => {
            let name = renamed(module, &REST);
            Pieces { modules: vec![name.to_owned()], swapped: name == "norm_out.linear" }
        }
    }
}

type Table<const N: usize> = [(&'static str, &'static str); N];

const DOUBLE: Table<12> = [
    ("img_mod.lin", "norm1.linear"),
    ("txt_mod.lin", "norm1_context.linear"),
    ("img_attn.proj", "attn.to_out.0"),
    ("txt_attn.proj", "attn.to_add_out"),
    ("img_attn.norm.query_norm", "attn.norm_q"),
    ("img_attn.norm.key_norm", "attn.norm_k"),
    ("txt_attn.norm.query_norm", "attn.norm_added_q"),
    ("txt_attn.norm.key_norm", "attn.norm_added_k"),
    ("img_mlp.0", "ff.net.0.proj"),
    ("img_mlp.2", "ff.net.2"),
    ("txt_mlp.0", "ff_context.net.0.proj"),
    ("txt_mlp.2", "ff_context.net.2"),
];

const SINGLE: Table<4> = [
    ("modulation.lin", "norm.linear"),
    ("linear2", "proj_out"),
    ("norm.query_norm", "attn.norm_q"),
    ("norm.key_norm", "attn.norm_k"),
];

const REST: Table<10> = [
    ("img_in", "x_embedder"),
    ("txt_in", "context_embedder"),
    ("time_in.in_layer", "time_text_embed.timestep_embedder.linear_1"),
    ("time_in.out_layer", "time_text_embed.timestep_embedder.linear_2"),
    ("guidance_in.in_layer", "time_text_embed.guidance_embedder.linear_1"),
    ("guidance_in.out_layer", "time_text_embed.guidance_embedder.linear_2"),
    ("vector_in.in_layer", "time_text_embed.text_embedder.linear_1"),
    ("vector_in.out_layer", "time_text_embed.text_embedder.linear_2"),
    ("final_layer.adaLN_modulation.1", "norm_out.linear"),
    ("final_layer.linear", "proj_out"),
];

fn renamed<'a, const N: usize>(name: &'a str, table: &Table<N>) -> &'a str {
    table.iter().find(|(ours, _)| *ours == name).map_or(name, |(_, theirs)| theirs)
}
