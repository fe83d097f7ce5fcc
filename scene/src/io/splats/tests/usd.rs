//! Tests of splats in USD text.

use super::*;

/// Two splats as USD text. `metadata` is a part of the head, `transform` the operations of the prim around the
/// splats, and `more` a list of additional attributes.
fn usda(metadata: &str, transform: &str, more: &str) -> String {
    format!(
        "#usda 1.0\n(\n    doc = \"made (here)\"\n    {metadata}\n)\n# a note {{\ndef Xform \"World\" (\n    kind = \"x\"\n)\n{{\n    {transform}\n\
         def ParticleField3DGaussianSplat \"Splats\"\n    {{\n        point3f[] positions = [(1, 2, 3),\n (-1, 0, 0.5)]\n\
         quatf[] orientations = [(1, 0, 0, 0), (0.5, 0.5, -0.5, 0.5)]\n        float3[] scales = [(0.1, 0.2, 0.3), (1, 1, 0)]\n\
         half[] opacitiesh = [1, 0.25]\n        uniform int radiance:sphericalHarmonicsDegree = 1\n\
         float3[] radiance:sphericalHarmonicsCoefficients = [(0.5, 0.25, -0.5), (1,2,3), (4,5,6), (7,8,9), (1,1,1), (0,0,0), (0,0,0), (0,0,0)]\n\
         uniform token projectionModeHint = \"perspective\"\n{more}    }}\n}}\n"
    )
}

/// USD as its grammar allows it gives the same splats: comments, quotes, blocked values, settings in strings, and
/// operations of transforms in any order. Prims that are not drawn are skipped, and data elsewhere are reported.
#[test]
fn usd_is_read_as_its_grammar_and_its_stage_say() {
    let metres = "upAxis = \"Z\"\n    metersPerUnit = 1";
    let load = |text: &str| from_bytes("a.usda", text.as_bytes(), Frame::AsStored, &context());
    // The unit counts also where the axes do not. This test fails if the note does not depend on the frame.
    for (frame, says) in [(Frame::AsStored, true), (Frame::ByFormat, false)] {
        let (_, notes) = from_bytes("a.usda", usda(metres, "", "").as_bytes(), frame, &context()).unwrap();
        let unit = &notes.iter().find(|note| note.id == "usd-unit").unwrap().text;
        assert_eq!(unit.contains("by which its coordinates are multiplied"), says, "{unit}");
    }
    let wanted = load(&usda(metres, "", "")).unwrap().0;
    for text in [
        usda("upAxis = 'Z' # up\n    metersPerUnit = 1; kind = \"x\"", "", ""),
        usda(&format!("doc = \"\"\"\n upAxis = \"Y\"\n metersPerUnit = 9\n\"\"\"\n {metres}"), "", ""),
        usda(&format!("doc = '''\n upAxis = \"Y\"\n metersPerUnit = 9\n'''\n {metres}"), "", ""),
        usda(metres, "// a }\n /* {\n { */ string note = 'a { \" b' (\n doc = \"}\"\n )\n", ""),
        usda(metres, "asset a = @b [c].png@\n rel r = </World/Mat>\n string s = \"a \\\" { b\"\n", ""),
        usda(metres, "", "        float[] opacities = None\n        vector3f[] velocities = None\n"),
        usda(metres, "", "")
            .replace("\"Splats\"", "'Splats'")
            .replace("(-1, 0, 0.5)", "// x\n(-1, 0, 0.5) /* ] */"),
        usda(metres, "token visibility = \"inherited\"\n float3 xformOp:scale\n", ""),
        // An order without values, and values without an order.
        usda(metres, "uniform token[] xformOpOrder = [\"xformOp:orient\"]\n", ""),
        usda(metres, "double3 xformOp:translate = (5, 0, 0)\n", ""),
    ] {
        assert!(load(&text).unwrap_or_else(|e| panic!("{e}: {text}")).0 == wanted, "{text}");
    }
    let first = |text: &str| load(text).unwrap_or_else(|e| panic!("{e}")).0.means[0];
    // The point (1, 2, 3). The last operation in the order comes first.
    let order = |names: &str| format!("uniform token[] xformOpOrder = [{names}]\n");
    let turned = "float3 xformOp:rotateXYZ = (90, 0, 90)\n double3 xformOp:translate = (10, 0, 0)\n";
    for (transform, point) in [
        (format!("{turned}{}", order("\"xformOp:translate\", \"xformOp:rotateXYZ\"")), [13.0, 1.0, 2.0]),
        (format!("{turned}{}", order("\"xformOp:rotateXYZ\", \"xformOp:translate\"")), [3.0, 11.0, 2.0]),
        (format!("quatf xformOp:orient = (0, 0, 0, 1)\n{}", order("\"xformOp:orient\"")), [-1.0, -2.0, 3.0]),
    ] {
        near(&first(&usda(metres, &transform, "")), &point, 1e-5);
    }
    let reset = "        uniform token[] xformOpOrder = [\"!resetXformStack!\"]\n";
    let moved = format!("double3 xformOp:translate = (10, 0, 0)\n{}", order("\"xformOp:translate\""));
    near(&first(&usda(metres, &moved, reset)), &[1.0, 2.0, 3.0], 0.0);
    // A second prim of splats, which is drawn or not.
    let second = |specifier: &str, settings: &str, body: &str| {
        let splats = "def ParticleField3DGaussianSplat \"T\" { point3f[] positions = [(7, 7, 7)] }\n";
        format!("{}{specifier} \"Other\" {settings}\n{{\n{splats}{body}}}\n", usda(metres, "", ""))
    };
    let (splats, notes) = load(&second("def", "", "")).unwrap();
    assert_eq!(splats.len(), 3);
    assert!(notes.iter().any(|note| note.id == "usd-no-colour"), "the second prim has no colours");
    // Linear 0.214 is 0.5 of the display.
    for (more, ids) in [
        ("color3f[] primvars:displayColor = [(1, 0.21404114, 0)]", "usd-display-colour"),
        ("uniform token purpose = \"render\"", "usd-no-colour"),
    ] {
        let text = second("def", "", "").replace("[(7, 7, 7)] }", &format!("[(7, 7, 7)]\n{more}\n}}"));
        let (splats, notes) = load(&text).unwrap();
        assert!(notes.iter().any(|note| note.id == ids), "{text}");
        let colour = splats.sh[2 * splats.sh_len()].map(|c| 0.5 + c * SH_C0 as f32);
        let wanted = if ids == "usd-no-colour" { [0.5; 3] } else { [1.0, 0.5, 0.0] };
        near(&colour, &wanted, 1e-6);
    }
    let two = second("def", "", "")
        .replace("[(7, 7, 7)] }", "[(7, 7, 7)]\ncolor3f[] primvars:displayColor = [(1, 1, 1), (0, 0, 0)]\n}");
    assert!(
        load(&two).err().unwrap().message().contains("`primvars:displayColor` has 6 numbers for 1 splats")
    );
    for (specifier, settings, body) in [
        ("def Xform", "(active = false)", ""),
        ("def Xform", "", "token visibility = \"invisible\"\n"),
        ("def Xform", "", "uniform token purpose = \"guide\"\n"),
        ("over", "", ""),
        ("class Xform", "", ""),
        ("def Xform", "(active = false)", "double xformOp:rotateX.timeSamples = { 0: 1 }\n"),
    ] {
        let text = second(specifier, settings, body);
        let (splats, notes) = load(&text).unwrap_or_else(|e| panic!("{e}: {text}"));
        assert!(splats == wanted && notes.iter().any(|note| note.id == "usd-hidden"), "{text}");
    }
    let reference = "(prepend references = @./a.usda@</S> (offset = 1))";
    let (splats, notes) = load(&second("def", reference, "")).unwrap();
    assert_eq!(splats.len(), 3);
    let text = notes.iter().find(|note| note.id == "usd-elsewhere").map(|note| note.text.as_str());
    assert!(notes.is_degraded() && text.is_some_and(|text| text.contains("the references of `Other`")));
    assert!(!load(&second("def", "(references = None)", "")).unwrap().1.is_degraded());
    let variants = "variantSet \"lod\" = {\n \"high\" {\n }\n }\n";
    assert!(load(&second("def", "", variants)).unwrap().1.is_degraded());
    let alone = |prim: &str| format!("#usda 1.0\n(\n {metres}\n)\ndef {prim} {{ }}\n");
    for (text, says) in [
        (alone("\"A\" (payload = @b.usda@)"), "the payload of `A`"),
        (
            alone("ParticleField3DGaussianSplat \"A\" (references = @b.usda@)"),
            "the references of the splats `A`",
        ),
        (
            alone("ParticleField3DGaussianSplat \"A\" (active = false)"),
            "are inactive, invisible, guides, proxies or not defined",
        ),
        (
            alone("\"A\"").replace("metersPerUnit", "subLayers = [@b.usda@]\n metersPerUnit"),
            "the subLayers of the file",
        ),
        (second("def", "", "double xformOp:rotateX.timeSamples = { 0: 1 }\n"), "animated USD"),
    ] {
        let error = load(&text).err().unwrap_or_else(|| panic!("{text}"));
        assert!(error.message().contains(says), "{error}");
    }
}

/// Splats in USD text are read with the right values, unit, axis and transforms, and unsupported files are refused.
#[test]
fn splats_of_usd_in_text_are_read() {
    let stored = |text: &str| from_bytes("a.usda", text.as_bytes(), Frame::AsStored, &context());
    let metres = "upAxis = \"Z\"\n    metersPerUnit = 1";
    let (splats, _) = stored(&usda(metres, "", "")).unwrap();
    assert_eq!((splats.len(), splats.sh_degree), (2, 1));
    near(splats.means.as_flattened(), &[1.0, 2.0, 3.0, -1.0, 0.0, 0.5], 1e-6);
    near(&splats.scales[1], &[1.0, 1.0, 0.0], 1e-6);
    near(&splats.opacities, &[1.0, 0.25], 0.0);
    near(&splats.quats[1], &[0.5, 0.5, -0.5, 0.5], 1e-6);
    near(splats.sh[..2].as_flattened(), &[0.5, 0.25, -0.5, 1.0, 2.0, 3.0], 1e-5);
    let means = |metadata: &str, transform: &str| {
        let (splats, _) =
            from_bytes("a", usda(metadata, transform, "").as_bytes(), Frame::ByFormat, &context())
                .unwrap_or_else(|e| panic!("{e}"));
        (splats.means[0], splats.scales[0][0])
    };
    // The world of the test has +z up: y up is turned, centimetres are metres.
    let close = |(a, s): ([f32; 3], f32), b: [f32; 3], t: f32| {
        near(&[a[0], a[1], a[2], s], &[b[0], b[1], b[2], t], 1e-6);
    };
    close(means("upAxis = \"Z\"\n metersPerUnit = 0.5", ""), [0.5, 1.0, 1.5], 0.05);
    close(means("upAxis = \"Y\"\n metersPerUnit = 1", ""), [1.0, -3.0, 2.0], 0.1);
    close(means("upAxis = \"Z\"", ""), [0.01, 0.02, 0.03], 0.001);
    let moved = "matrix4d xformOp:transform = ( (2,0,0,0), (0,2,0,0), (0,0,2,0), (10,0,0,1) )\n\
        uniform token[] xformOpOrder = [\"xformOp:transform\"]\n";
    close(means(metres, moved), [12.0, 4.0, 6.0], 0.2);
    let steps = "double3 xformOp:translate = (10, 0, 0)\n float3 xformOp:scale = (2, 2, 2)\n\
        uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:scale\"]\n";
    close(means(metres, steps), [12.0, 4.0, 6.0], 0.2);
    for (text, says) in [
        (usda(metres, "", "        point3f[] positions.timeSamples = { 0: [(1,2,3)] }\n"), "animated USD"),
        (usda(metres, &steps.replace("xformOp:scale", "xformOp:rotateX"), ""), "rotateX"),
        (usda(metres, &steps.replace("(2, 2, 2)", "(2, 1, 2)"), ""), "non-uniform"),
        (usda("upAxis = \"X\"", "", ""), "not Y or Z"),
        (usda("metersPerUnit = 0", "", ""), "metersPerUnit"),
        (usda(metres, "", "        float[] opacities = [1, 2, 3]\n"), "3 numbers for 2 splats"),
        (usda(metres, "", "").replace("ParticleField3DGaussianSplat", "Mesh"), "no prim of the type"),
        (usda(metres, "", "").replace("}\n}", "}"), "is not closed"),
    ] {
        let error = stored(&text).err().unwrap();
        assert!(error.message().contains(says), "{error}");
    }
    let error = read(b"PXR-USDC\0\0").err().unwrap();
    assert!(error.message().contains("save it as text"), "{error}");
    // A file that is cut off anywhere, or in which bytes are changed, gives an error or a scene.
    let whole = usda(metres, moved, "").into_bytes();
    let mut seed = 1_u64;
    for turn in 0..4000 {
        let mut bytes = whole.clone();
        for _ in 0..=turn % 3 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let at = (seed >> 33) as usize % bytes.len();
            match seed >> 62 {
                0 => bytes.truncate(at.max(8)),
                1 => bytes[at] = b"()[]{}\"#=,\n'@<>/*"[(seed >> 50) as usize % 17],
                2 => drop(bytes.remove(at)),
                _ => bytes[at] ^= 1 << (seed >> 55 & 7),
            }
        }
        if let Ok((splats, _)) = read(&bytes) {
            assert!(splats.len() <= bytes.len());
        }
    }
}
