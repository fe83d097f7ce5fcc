//! Parameters of earlier versions, and their replacements.

use engine::Former;

/// The four former parameters that [`super::surroundings`] replaces.
const VISIBILITY: [&str; 4] = ["env_block", "bounce", "object_specular_sees", "near_field"];
/// Last version of the kind that had these parameters.
const LAST: u32 = 19;

/// Returns the replacement of the parameter `name` of an earlier version, or `None` if there was no such parameter.
/// `fields` holds the name and the value of each parameter of the node, as written in the graph.
pub(super) fn former(name: &str, fields: &[(&str, &str)]) -> Option<Former> {
    if name == "skip_lobes" {
        return Some(Former::exhaustive(&["skip_lobes"], LAST));
    }
    VISIBILITY.contains(&name).then(|| {
        let text =
            |name: &str| fields.iter().find(|(field, _)| *field == name).map_or("Auto", |(_, text)| text);
        let [block, bounce, specular, near] = VISIBILITY.map(text);
        let instead = match surroundings(block, bounce, specular, near) {
            Some(choice) => format!("write `surroundings: {choice}`"),
            None => "no choice of `surroundings` is equivalent to this combination; \
                     `lightharmony nodes path-trace` lists the choices"
                .to_owned(),
        };
        Former { fields: &VISIBILITY, last: LAST, instead }
    })
}

/// Choice of `surroundings` that replaces the values of the four former parameters. `None` if no choice is
/// equivalent.
fn surroundings(block: &str, bounce: &str, specular: &str, near: &str) -> Option<String> {
    let plain = |text: &str| text.chars().filter(|c| !c.is_whitespace()).collect::<String>();
    let [block, bounce, specular, near] = [block, bounce, specular, near].map(plain);
    let (name, inside) = block.split_once('(').unwrap_or((&block, ")"));
    let inside = inside.strip_suffix(')')?;
    let number = inside.split_once(':').map_or(inside, |(_, number)| number.trim_end_matches(','));
    let bounces = match bounce.as_str() {
        "Auto" => None,
        "Solid" => Some(true),
        "Env" => Some(false),
        _ => return None,
    };
    // Reflections show the panorama through a transparent mesh. For a solid mesh, the point of capture decides.
    let implied = match name {
        "Solid" | "Paper" => true,
        _ => specular != "Receiver",
    };
    if near == "On" && name != "Paper" {
        return Some("Projected".to_owned());
    }
    if !implied || !matches!(near.as_str(), "Auto" | "Off") {
        return None;
    }
    let with = |name: &str, mut parts: Vec<String>, usual: bool| {
        parts
            .extend(bounces.filter(|bounces| *bounces != usual).map(|bounces| format!("bounces: {bounces}")));
        if parts.is_empty() { name.to_owned() } else { format!("{name}({})", parts.join(", ")) }
    };
    Some(match name {
        "Auto" if bounces.is_some() || specular != "Auto" => return None,
        "Auto" => if near == "Off" { "Distant" } else { "Auto" }.to_owned(),
        "Solid" => with("Open", Vec::new(), true),
        "Pass" => with("Transparent", Vec::new(), false),
        "FrontFace" => {
            let layers = if number.is_empty() { "3" } else { number };
            with("Room", vec![format!("layers: {layers}")], false)
        }
        "PassBeyond" if !number.is_empty() => with("Within", vec![format!("metres: {number}")], false),
        "Paper" if near == "Auto" => "Paper".to_owned(),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each former value is replaced, and combinations without a replacement are recognised.
    #[test]
    fn former_visibility_is_spelled_anew() {
        for (fields, choice) in [
            (vec![("env_block", "Solid")], "`surroundings: Open`"),
            (vec![("env_block", "Solid"), ("bounce", "Env")], "`surroundings: Open(bounces: false)`"),
            (vec![("env_block", "Pass"), ("bounce", "Env")], "`surroundings: Transparent`"),
            (vec![("env_block", "Pass"), ("bounce", "Solid")], "`surroundings: Transparent(bounces: true)`"),
            (vec![("env_block", "FrontFace( max_layers: 2 )")], "`surroundings: Room(layers: 2)`"),
            (
                vec![("env_block", "FrontFace(max_layers: 3)"), ("bounce", "Solid")],
                "`surroundings: Room(layers: 3, bounces: true)`",
            ),
            (vec![("env_block", "PassBeyond(metres: 1.1)")], "`surroundings: Within(metres: 1.1)`"),
            (vec![("env_block", "Paper")], "`surroundings: Paper`"),
            (vec![("near_field", "On")], "`surroundings: Projected`"),
            (vec![("near_field", "Off")], "`surroundings: Distant`"),
            (vec![("near_field", "Off"), ("env_block", "Solid")], "`surroundings: Open`"),
            (vec![("env_block", "Auto")], "`surroundings: Auto`"),
            (vec![("bounce", "Solid")], "no choice"),
            (vec![("env_block", "Pass"), ("object_specular_sees", "Receiver")], "no choice"),
            (vec![("near_field", "On"), ("env_block", "Paper")], "no choice"),
            (vec![("env_block", "Axis(\"block\")")], "no choice"),
        ] {
            let former = former(fields[0].0, &fields).expect("a former parameter");
            assert!(former.instead.contains(choice), "{fields:?}: {}", former.instead);
        }
        assert!(former("samples", &[("samples", "4")]).is_none());
    }
}
