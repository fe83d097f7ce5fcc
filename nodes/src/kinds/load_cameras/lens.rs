//! Lenses of cameras in JSON: focal lengths, and distortion with the models of nerfstudio and instant-ngp.

use scene::io::capture::distortion::{Bend, Coefficients};
use scene::math::num;
use serde_json::Value;

/// Returns `frame` if it has one of `keys`, and otherwise the top level of the file.
pub fn level<'a>(top: &'a Value, frame: &'a Value, keys: &[&str]) -> &'a Value {
    if keys.iter().any(|key| !frame[*key].is_null()) { frame } else { top }
}

/// Number of a key as nerfstudio reads it: a number, or a text that holds a number. `None` if the key is absent or
/// null; any other value is an error.
pub fn optional(holder: &Value, key: &str) -> Result<Option<f64>, String> {
    let number = match &holder[key] {
        Value::Null => return Ok(None),
        Value::Number(number) => number.as_f64(),
        Value::String(text) => text.trim().parse().ok(),
        _ => None,
    };
    number.map(Some).ok_or_else(|| format!("has a `{key}` that is not a number"))
}

/// Focal length along an axis, in pixels. The file gives it as a length, or as a field of view in radians or in
/// degrees. `None` if the file gives none of these. A field of view outside 0 to 180 degrees is an error.
pub fn focal(
    holder: &Value,
    [length, radians, degrees]: [&str; 3],
    size: u64,
) -> Result<Option<f64>, String> {
    if let Some(length) = optional(holder, length)? {
        return Ok(Some(length));
    }
    if let Some(angle) = optional(holder, radians)? {
        return by_angle(angle, size).map(Some).ok_or_else(|| {
            format!(
                "has the angle `{radians}` {angle}, which is not between 0 and pi: `{radians}` is in radians; for an \
                 angle in degrees, use `{degrees}`"
            )
        });
    }
    let Some(angle) = optional(holder, degrees)? else { return Ok(None) };
    by_angle(angle.to_radians(), size)
        .map(Some)
        .ok_or_else(|| format!("has the angle `{degrees}` {angle}, which is not between 0 and 180 degrees"))
}

/// Focal length in pixels of a lens whose field of view, in radians, covers `size` pixels. `None` if the field of
/// view is not between 0 and pi.
pub fn by_angle(angle: f64, size: u64) -> Option<f64> {
    let valid = angle > 0.0 && angle < std::f64::consts::PI;
    valid.then(|| size as f64 / 2.0 / num::f64::tan(angle / 2.0))
}

/// Names of the coefficients of lens distortion, in the order of [`Coefficients`].
const COEFFICIENTS: [&str; 8] = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];
/// Positions of the numbers of nerfstudio's `distortion_params` in [`COEFFICIENTS`]: k1, k2, k3, k4, p1, p2.
const LISTED: [usize; 6] = [0, 1, 2, 3, 6, 7];

/// Coefficients of lens distortion of a frame, and the non-zero coefficients as text. They are keys of their own,
/// or the numbers of the list `distortion_params`. If both give a coefficient, the larger magnitude counts, since
/// programs differ in which they prefer.
fn coefficients(top: &Value, frame: &Value) -> Result<(Coefficients, Vec<String>), String> {
    const LIST: &str = "distortion_params";
    let mut numbers = [0.0; COEFFICIENTS.len()];
    for (name, to) in COEFFICIENTS.into_iter().zip(&mut numbers) {
        *to = optional(level(top, frame, &[name]), name)?.unwrap_or(0.0);
    }
    match &level(top, frame, &[LIST])[LIST] {
        Value::Null => {}
        Value::Array(list) => {
            let listed = list.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
            let listed = listed.ok_or_else(|| format!("has a `{LIST}` whose entries are not numbers"))?;
            if listed.len() != LISTED.len() && listed.iter().any(|number| *number != 0.0) {
                return Err(format!(
                    "has a `{LIST}` of length {}, instead of the six numbers k1, k2, k3, k4, p1, p2",
                    listed.len()
                ));
            }
            for (at, number) in LISTED.into_iter().zip(listed) {
                if number.abs() > numbers[at].abs() {
                    numbers[at] = number;
                }
            }
        }
        _ => return Err(format!("has a `{LIST}` that is not a list of numbers")),
    }
    let named = COEFFICIENTS.iter().zip(numbers).filter(|(_, number)| *number != 0.0);
    let bends = named.map(|(name, number)| format!("{name} {number}")).collect();
    let [k @ .., p1, p2] = numbers;
    Ok((Coefficients { k, p: [p1, p2], ..Coefficients::default() }, bends))
}

/// Keys in instant-ngp's `transforms.json` that mark lenses other than pinhole cameras.
const OTHER_LENSES: [&str; 4] = ["latlong", "equirectangular", "orthographic", "is_equirectangular"];
/// Key whose presence, whatever its value, marks an F-theta lens for instant-ngp.
const F_THETA: &str = "ftheta_p0";

/// Lens distortion of a camera with a picture of this size and a lens (fx, fy, cx, cy); `None` if it has none. Values
/// missing in a frame are taken from the top level of the file. Models other than pinhole cameras are errors.
pub fn bend(top: &Value, frame: &Value, size: [u64; 2], lens: [f64; 4]) -> Result<Option<Bend>, String> {
    let holder = |key: &str| level(top, frame, &[key]);
    let model = holder("camera_model")["camera_model"].as_str().unwrap_or("OPENCV");
    let (found, bends) = coefficients(top, frame)?;
    let f_theta = (!holder(F_THETA)[F_THETA].is_null()).then_some(F_THETA);
    if let Some(flag) = OTHER_LENSES.into_iter().find(|flag| is_set(&holder(flag)[*flag])).or(f_theta) {
        return Err(format!("has `{flag}`, so it is not a pinhole camera"));
    }
    let flag = is_set(&holder("is_fisheye")["is_fisheye"]);
    let fisheye = type_of_camera(holder("camera_type"))? || flag;
    let upper = model.to_ascii_uppercase();
    // Fisheye models distort even when all their coefficients are 0.
    let bent = match upper.as_str() {
        _ if fisheye || upper.contains("FISHEYE") => true,
        "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "PERSPECTIVE" | "SIMPLE_RADIAL" | "RADIAL"
        | "FULL_OPENCV" => !found.is_zero(),
        _ => return Err(format!("has the camera model `{model}`, which is not a pinhole camera")),
    };
    let fish = fisheye || upper.contains("FISHEYE");
    let pixels = if fish { f64::INFINITY } else { found.pixels(size, lens) };
    let name = match fisheye {
        true if flag => format!("{model}, `is_fisheye`"),
        true => format!("{model}, `camera_type` fisheye"),
        false => model.to_owned(),
    };
    let applied = match upper.as_str() {
        "OPENCV" | "OPENCV_FISHEYE" | "FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" if fish => {
            found.fisheye()
        }
        _ if fish => None,
        // nerfstudio does not have the model, so its keys have the meaning that OpenCV gives them.
        "FULL_OPENCV" => Some(found.rational()),
        _ => found.polynomial(),
    };
    Ok(bent.then(|| Bend { text: [vec![name], bends].concat().join(" "), model: applied, pixels }))
}

/// Reads `camera_type`, the key of the paths of nerfstudio's viewer, which other programs write into `transforms.json`.
/// Returns whether it states a fisheye lens.
fn type_of_camera(holder: &Value) -> Result<bool, String> {
    let Some(text) = holder["camera_type"].as_str() else { return Ok(false) };
    match text.to_ascii_lowercase().as_str() {
        "perspective" | "pinhole" | "opencv" => Ok(false),
        "fisheye" | "opencv_fisheye" => Ok(true),
        _ => Err(format!("has the camera type `{text}`, which is not a pinhole camera")),
    }
}

/// True if a flag is set: programs write it as `true`, a number or a text.
fn is_set(value: &Value) -> bool {
    match value {
        Value::Bool(set) => *set,
        Value::Number(number) => number.as_f64() != Some(0.0),
        Value::String(text) => matches!(text.to_ascii_lowercase().as_str(), "true" | "1" | "yes"),
        _ => false,
    }
}
