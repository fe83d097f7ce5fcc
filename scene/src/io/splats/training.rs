//! Comments of PLY files in which trainers state how the splats were trained, and which axis is up.

use engine::{Notes, Up};

/// True if the comments say that the splats were trained antialiased, as the flags of SPZ and SOG do:
/// `SplatRenderMode: mip` (Brush, gsplat, splat-transform), `antialiased 1` (Postshot), or the proposed
/// `train_flags antialiasing`. As in splat-transform, the last such comment is used.
pub(super) fn antialiased(comments: &[String], file: &str, notes: &mut Notes) -> bool {
    let Some((yes, comment)) = comments.iter().rev().find_map(|text| Some((flag(text)?, text))) else {
        return false;
    };
    if yes {
        let text = format!(
            "the splats of `{file}` were trained with antialiasing, according to its comment `{}`",
            comment.trim()
        );
        notes.decision("antialiased", text);
    }
    yes
}

/// The axis of the comment `Vertical Axis: z`, which nerfstudio writes into PLY files. The last such comment counts.
pub(super) fn vertical_axis(comments: &[String]) -> Option<Up> {
    comments.iter().rev().find_map(|comment| {
        let (name, axis) = comment.split_once(':')?;
        let axis =
            name.trim().eq_ignore_ascii_case("vertical axis").then(|| axis.trim().to_ascii_lowercase())?;
        match axis.as_str() {
            "z" | "+z" => Some(Up::PlusZ),
            "y" | "+y" => Some(Up::PlusY),
            "-y" => Some(Up::MinusY),
            _ => None,
        }
    })
}

/// The value that a comment states for antialiasing; `None` if the comment does not mention antialiasing.
fn flag(comment: &str) -> Option<bool> {
    let lower = comment.to_ascii_lowercase();
    let words: Vec<&str> =
        lower.split(|c: char| c.is_ascii_whitespace() || matches!(c, ':' | '=' | ',')).collect();
    let words: Vec<&str> = words.into_iter().filter(|word| !word.is_empty()).collect();
    match words[..] {
        ["splatrendermode", mode, ..] => Some(matches!(mode, "mip" | "antialiased")),
        ["rasterize_mode" | "rasterizemode", mode, ..] => Some(mode == "antialiased"),
        ["antialiased" | "antialias" | "anti_aliased" | "antialiasing", value, ..] => match value {
            "1" | "true" | "yes" | "on" => Some(true),
            "0" | "false" | "no" | "off" => Some(false),
            _ => None,
        },
        ["antialiased"] => Some(true),
        ["train_flags", ref flags @ ..] => {
            Some(flags.iter().any(|flag| matches!(*flag, "antialiasing" | "antialiased")))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_of_trainers_are_understood_and_the_last_one_counts() {
        let of = |lines: &[&str]| {
            let lines: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
            antialiased(&lines, "a.ply", &mut Notes::none())
        };
        for yes in [
            "SplatRenderMode: mip",
            "splatrendermode:MIP ",
            "antialiased 1",
            "antialiased: true",
            "train_flags antialiasing",
            "rasterize_mode antialiased",
        ] {
            assert!(of(&["Exported from Brush", yes, "SH degree: 3"]), "{yes}");
        }
        for no in [
            "SplatRenderMode: default",
            "SplatRenderMode: 2dgs",
            "antialiased 0",
            "this scene is not antialiased 1",
            "antialiased edges look better",
            "rasterize_mode classic",
        ] {
            assert!(!of(&[no]), "{no}");
        }
        assert!(!of(&["antialiased 1", "SplatRenderMode: default"]));
        assert!(of(&["antialiased 0", "SplatRenderMode: mip"]));
    }
}
