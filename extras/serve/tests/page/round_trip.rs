//! Random edits through the path of the page, and their undo, give the original bytes.

use std::time::Instant;

use crate::lab::{Lab, digest_of};

/// A graph with everything that an edit must leave as it is.
fn odd_graph() -> String {
    let text = "\u{feff}// Ünïcode, \u{1f600}\r\n/* (, \" */ Graph( version : 1 ,\n\
        scene:(up:\"+z\",metres_per_unit:1.0 ,seed : 3),parameters:(h:1.5,),\r\n\
        nodes:(\tpose/* the pose */ : Pose ( translation : ( 0.5 ,/*y*/ 1.0 , Param(\"h\") ) , yaw_deg:30.0, ) , // a \" in a comment\r\n\
        other: Pose(\r\n    translation: (\r\n        1.0, // x\r\n        2.0,\r\n        3.0,\r\n    ),\r\n    scale: 1.25, // scale, not (yaw\r\n),\n\
        bare: Pose(translation: (0.0, 0.0, 0.0)),\n\
        camera: Camera(eye:(2,-2.5,1.2),target:(0,0,0.2),width_px:32,height_px:18,fov_y_deg:4.0e1),\n\
        )\n,)\r\n\r\n// end";
    text.to_owned()
}

/// A number from a fixed sequence.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % limit
    }

    fn number(&mut self) -> String {
        let value = self.below(2_000_000) as f64 / 1000.0 - 1000.0;
        match self.below(4) {
            0 => format!("{value:e}"),
            1 => format!("{value:.1}"),
            2 => format!("{}", value.trunc()),
            _ => format!("{value:?}"),
        }
    }
}

/// 200 edits over HTTP; `src/editor/tests.rs` makes 10,000 edits without a server.
#[test]
fn edits_over_http_and_their_undo_give_the_original_bytes() {
    let text = odd_graph();
    let lab = Lab::new(&text);
    lab.idle();
    let (mut random, mut written, begin) = (Random(7), 0, Instant::now());
    for _ in 0..200 {
        let (node, field, at): (&str, &str, &[usize]) = match random.below(9) {
            0 => ("pose", "translation", &[0]),
            1 => ("pose", "translation", &[1]),
            2 => ("pose", "yaw_deg", &[]),
            3 => ("other", "translation", &[2]),
            4 => ("other", "yaw_deg", &[]),
            5 => ("bare", "yaw_deg", &[]),
            6 => ("camera", "eye", &[1]),
            7 => ("parameters", "h", &[]),
            _ => ("scene", "seed", &[]),
        };
        let value = if field == "seed" { random.below(100).to_string() } else { random.number() };
        let value = if at.is_empty() && random.below(5) == 0 { None } else { Some(value) };
        match lab.set(node, field, at, value.as_deref()).status {
            200 => written += 1,
            // A field that is not set cannot be removed, and some numbers are out of range.
            422 => {}
            other => panic!("{other}"),
        }
    }
    assert!(written > 100, "{written} edits");
    assert_ne!(lab.text(), text);
    loop {
        let undo = lab.post("/undo", &format!("{{\"digest\":\"{}\"}}", digest_of(&lab.text())));
        if undo.status != 200 {
            break;
        }
    }
    assert_eq!(lab.text(), text, "after {written} edits and {:?}", begin.elapsed());
}
