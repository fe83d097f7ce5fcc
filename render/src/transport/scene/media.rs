//! Stack of the transparent bodies that contain the current point of a path.
//!
//! A path carries the bodies that it has entered and not left. Only the body entered last absorbs light: a body
//! inside another displaces the outer medium, as ice does in water, so a body inside another body of the same
//! medium changes nothing. The indices of refraction on the two sides of a surface follow from the same stack. If a
//! ray leaves a body without having entered it, that body contains the start of the ray and is added outside the
//! known bodies. At infinity the stack is emptied, since a ray can leave an open mesh without hitting it.

use glam::Vec3;

/// Maximum number of nested bodies on the stack. If there are more, the outermost is forgotten until the path
/// leaves it.
pub const MOST: usize = 4;
/// Interior of the surfaces of one placed object that bound the same medium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Index of the placed object.
    pub placed: usize,
    /// Absorption coefficient per world unit.
    pub absorption: Vec3,
    /// Index of refraction.
    pub ior: f32,
}

/// Bodies around a point, outermost first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Media {
    bodies: [u32; MOST],
    depth: u32,
}

impl Media {
    pub(crate) fn all(&self) -> &[u32] {
        &self.bodies[..self.depth as usize]
    }

    /// True if there are no bodies.
    pub fn is_empty(&self) -> bool {
        self.depth == 0
    }

    /// True if this stack differs from `those` and contains at least as many bodies.
    pub fn is_deeper(&self, those: &Self) -> bool {
        self != those && self.depth >= those.depth
    }

    /// The stack after entering a body.
    pub(crate) fn enter(mut self, body: u32) -> Self {
        if self.depth as usize == MOST {
            self.bodies.rotate_left(1);
            self.depth -= 1;
        }
        self.bodies[self.depth as usize] = body;
        self.depth += 1;
        self
    }

    /// The stack after leaving a body.
    pub(crate) fn without(mut self, body: u32) -> Self {
        if let Some(at) = self.all().iter().rposition(|&b| b == body) {
            self.bodies.copy_within(at + 1.., at);
            self.depth -= 1;
        }
        self
    }

    /// The stack with a body added outside all others, unless the stack already contains it.
    pub(crate) fn amid(mut self, body: u32) -> Self {
        if !self.all().contains(&body) && (self.depth as usize) < MOST {
            self.bodies.rotate_right(1);
            self.bodies[0] = body;
            self.depth += 1;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn media(bodies: &[u32]) -> Media {
        bodies.iter().fold(Media::default(), |media, &body| media.enter(body))
    }

    #[test]
    fn bodies_are_entered_and_left() {
        assert_eq!(media(&[3, 7]).without(7).all(), [3]);
        assert_eq!(media(&[3, 7]).without(3).all(), [7], "overlapping ones in any order");
        assert_eq!(media(&[3, 7, 3]).without(3).all(), [3, 7], "the last of several of the same medium");
        assert_eq!(media(&[3]).without(7).all(), [3], "one that was not entered");
        assert_eq!(media(&[3]).amid(7).all(), [7, 3], "one that was not entered is around");
        assert_eq!(media(&[3, 7]).amid(7).all(), [3, 7]);
    }

    #[test]
    fn the_outermost_of_many_is_forgotten() {
        let full = media(&[0, 1, 2, 3, 4]);
        assert_eq!(full.all(), [1, 2, 3, 4]);
        assert_eq!(full.amid(0), full);
        assert_eq!(full.without(4).amid(0).all(), [0, 1, 2, 3], "until it is left");
    }
}
