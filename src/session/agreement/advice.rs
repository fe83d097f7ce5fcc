//! Texts of the findings of a comparison: what was measured, what is probably wrong, and what to change in the
//! graph.

use engine::Graph;
use glam::DVec3;
use nodes::kinds::load_mesh::{LoadMesh, MeshFrame};
use nodes::kinds::load_splats::LoadSplats;
use render::agreement::{Comparison, Finding, Likely, Moved, Regions};
use scene::types::frame::{Similarity, world_from_gltf};

use super::pair::{self, Pair, above, instance, written};

/// The findings about a pair of splats and mesh, as text.
pub fn texts(graph: &Graph, pair: &Pair, found: &Comparison) -> Vec<pair::Finding> {
    let [splats, mesh] = [pair.splats, pair.mesh].map(|wire| instance(graph, wire.node));
    let percent = 100.0 * found.agreement;
    let text = |finding: Finding| match finding {
        Finding::Elsewhere => {
            let text = match &found.best {
                Some(best) => format!(
                    "the agreement of the splats {splats} and the mesh {mesh} is {:.0} %; {}",
                    100.0 * best.before,
                    moved(graph, pair, best)
                ),
                None => format!(
                    "the agreement of the depths of the splats {splats} and the mesh {mesh} is {percent:.0} %, measured \
                     at {} points in the views and around the object. No combination of scale, rotation, reflection and shift of the mesh was found that makes the depths agree: check that the splats and the mesh show the same place, or \
                     use `ExtractMesh` instead of the mesh",
                    found.points
                ),
            };
            Some(("mesh-elsewhere", text))
        }
        // `splat-render` reports views that show nothing as `views-empty`.
        Finding::Cameras => None,
        Finding::Debris => {
            let text = format!(
                "parts of the mesh {mesh} float in front of the surfaces that the splats {splats} show. They cover {}. \
                 They cast shadows and may hide the object: remove them from the mesh, or use `ExtractMesh` instead of \
                 the mesh",
                place(&found.debris)
            );
            Some(("mesh-debris", text))
        }
        Finding::Missing => {
            let text = format!(
                "the mesh {mesh} lacks surfaces that the splats {splats} show. They cover {}. They receive no shadows \
                 and reflect no light: use a mesh that has them, or use `ExtractMesh` instead of the mesh",
                place(&found.missing)
            );
            Some(("mesh-incomplete", text))
        }
    };
    found.findings().into_iter().filter_map(text).collect()
}

/// Describes the sizes and positions of regions.
fn place(regions: &Regions) -> String {
    let views = if regions.view.is_empty() {
        "the views around the object".to_owned()
    } else {
        format!("the view `{}`", regions.view)
    };
    let percent = 100.0 * regions.share;
    format!("{percent:.1} % of the pixels of {views}; the largest part is near {}", vector(regions.at))
}

/// Describes the transform with which splats and mesh agree, and the parameter that applies it.
fn moved(graph: &Graph, pair: &Pair, best: &Moved) -> String {
    let (by, wire, input, kind, what) = match best.likely {
        Likely::Mesh => (best.by, pair.mesh, "mesh", "load-mesh", "mesh"),
        Likely::Splats => (best.by.inverse(), pair.splats, "splats", "load-splats", "splats"),
    };
    let loader = above(graph, wire.node, input).find(|&node| graph.nodes[node].kind.name == kind);
    let percent = 100.0 * best.agreement;
    if best.is_mirrored() {
        return format!(
            "with the mesh {}, the agreement is {percent:.0} %: the mesh was probably written for axes of the other \
             handedness, which `matrix` cannot change; export the mesh again with axes that are rotated, not swapped or \
             negated",
            mirrored(&best.by)
        );
    }
    let known = match loader {
        Some(node) if kind == "load-mesh" => {
            graph.nodes[node].params::<LoadMesh>().map(|p| (p.matrix, p.frame))
        }
        Some(node) => graph.nodes[node].params::<LoadSplats>().map(|p| (p.matrix, MeshFrame::Gltf)),
        None => None,
    };
    let scene = graph.scene;
    let of_gltf =
        Similarity::of_rows(&world_from_gltf(scene.up, scene.metres_per_unit).transpose().to_cols_array());
    let advice = match (loader, known) {
        (Some(node), Some((None, MeshFrame::World))) if of_gltf.as_ref().is_ok_and(|m| near(m, &by)) => {
            format!("set `frame: Gltf` on `{}`", written(graph, node))
        }
        (Some(node), Some((matrix, _))) => {
            let before = Similarity::of_parameter(matrix.as_ref()).unwrap_or(Similarity::IDENTITY);
            format!("set `matrix: {}` on `{}`", rows(&by.after(&before)), written(graph, node))
        }
        _ => format!("transform the {what} by the matrix {}", rows(&by)),
    };
    let other = if best.is_decided {
        ""
    } else {
        ", or the frame of the splats if the cameras and the mesh fit each other"
    };
    format!(
        "{}, the agreement is {percent:.0} %: the frame of the {what} is probably wrong{other}; {advice}",
        change(&by, what, best)
    )
}

/// Describes a transform of the mesh that contains a reflection.
fn mirrored(by: &Similarity) -> String {
    // The rows of the rotation.
    let rows = by.rotation.transpose();
    let coordinate = |row: DVec3| {
        let names = [("x", row.x), ("y", row.y), ("z", row.z)];
        let (name, value) = names.into_iter().find(|(_, value)| value.abs() > 0.999)?;
        Some(if value < 0.0 { format!("-{name}") } else { name.to_owned() })
    };
    let all = [rows.x_axis, rows.y_axis, rows.z_axis].map(coordinate);
    let mut parts = vec![match all {
        [Some(x), Some(y), Some(z)] => format!("mirrored ((x, y, z) becomes ({x}, {y}, {z}))"),
        _ => "mirrored".to_owned(),
    }];
    if (by.scale - 1.0).abs() > 1e-9 {
        parts.push(format!("scaled by {}", digits(by.scale, 4)));
    }
    if by.offset != DVec3::ZERO {
        parts.push(format!("shifted by {}", vector(by.offset)));
    }
    parts.join(" and ")
}

/// True if two transforms are equal up to the accuracy of the search.
fn near(a: &Similarity, b: &Similarity) -> bool {
    let off = a.rotation - b.rotation;
    let turned = off.x_axis.length().max(off.y_axis.length()).max(off.z_axis.length());
    turned < 1e-6 && (a.scale / b.scale - 1.0).abs() < 0.03 && b.offset.length() < 1e-9
}

/// Describes a transform of the mesh or of the splats.
fn change(by: &Similarity, what: &str, best: &Moved) -> String {
    let mut parts = Vec::new();
    if (by.scale - 1.0).abs() > 1e-9 {
        parts.push(format!("scaled by {}", digits(by.scale, 4)));
    }
    if best.turn_deg > 0.5 {
        let r = by.rotation;
        let axis = DVec3::new(r.y_axis.z - r.z_axis.y, r.z_axis.x - r.x_axis.z, r.x_axis.y - r.y_axis.x);
        let about =
            if axis.length() > 1e-6 { format!(" about {}", vector(axis.normalize())) } else { String::new() };
        parts.push(format!("rotated by {:.0} degrees{about}", best.turn_deg));
    }
    if by.offset != DVec3::ZERO {
        parts.push(format!("shifted by {}", vector(by.offset)));
    }
    format!("with the {what} {}", parts.join(" and "))
}

/// The matrix of a transform in the notation of graph files. Elements below the accuracy of the search are 0.
fn rows(by: &Similarity) -> String {
    let one = |(i, value): (usize, &f64)| {
        let size = if i % 4 == 3 { by.offset.length() } else { by.scale };
        if value.abs() <= 1e-6 * size { "0.0".to_owned() } else { digits(*value, 6) }
    };
    let all: Vec<String> = by.rows()[..12].iter().enumerate().map(one).collect();
    format!("Some(({}, 0.0, 0.0, 0.0, 1.0))", all.join(", "))
}

fn vector(v: DVec3) -> String {
    let [x, y, z] =
        v.to_array().map(|c| if c.abs() < 1e-6 * v.length() { "0.0".to_owned() } else { digits(c, 3) });
    format!("({x}, {y}, {z})")
}

/// A number with `count` significant digits and a decimal point.
fn digits(value: f64, count: usize) -> String {
    let mut decimals = count;
    let mut size = value.abs();
    while size >= 1.0 && decimals > 0 {
        (size, decimals) = (size / 10.0, decimals - 1);
    }
    let mut size = value.abs();
    while size > 0.0 && size < 0.1 && decimals < 12 {
        (size, decimals) = (size * 10.0, decimals + 1);
    }
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0') } else { &text };
    if text.ends_with('.') || !text.contains('.') {
        format!("{}.0", text.trim_end_matches('.'))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reflection is described by the new coordinates. This test fails without the transposition in `mirrored`.
    #[test]
    fn reflections_are_described_by_coordinates() {
        // x becomes -y, y becomes z, z becomes x.
        let rotation = glam::DMat3::from_cols(DVec3::Z, DVec3::NEG_X, DVec3::Y);
        let by = Similarity { rotation, scale: 0.01, offset: DVec3::ZERO };
        assert_eq!(mirrored(&by), "mirrored ((x, y, z) becomes (-y, z, x)) and scaled by 0.01");
    }

    #[test]
    fn numbers_are_those_of_graphs() {
        assert_eq!(
            [1.0, 0.01, -39.3701, 1234.5678].map(|v| digits(v, 4)),
            ["1.0", "0.01", "-39.37", "1235.0"]
        );
        let half = Similarity { scale: 0.5, ..Similarity::IDENTITY };
        assert!(rows(&half).starts_with("Some((0.5, 0.0, 0.0, 0.0, 0.0, 0.5,"), "{}", rows(&half));
        // A far shift does not hide a small factor.
        let far = Similarity { scale: 0.001, offset: DVec3::new(5e6, 1e-4, 0.0), ..Similarity::IDENTITY };
        let wanted = "Some((0.001, 0.0, 0.0, 5000000.0, 0.0, 0.001, 0.0, 0.0, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0, 0.0, 1.0))";
        assert_eq!(rows(&far), wanted);
    }
}
