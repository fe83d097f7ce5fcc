//! Builds the eight-wide tree from triangles.

use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::ploc::{PlocSearchDistance, SortPrecision};
use obvhs::{BvhBuildParams, bvh2::Bvh2, bvh2::builder::build_bvh2};

use super::collapse::{Branch, Collapse};
use super::triangles::Packet;
use super::{Bvh, LEAF, LEAF_SHIFT, Node, STACK, WIDE};

/// Maximum number of triangles with the same centre for which `obvhs` is used. It joins one pair of such triangles
/// per pass, so its time is quadratic in their number.
const CROWD: usize = 1024;

impl Bvh {
    /// Builds a tree of triangles, given by their corners.
    pub fn build(corners: &[[Vec3; 3]]) -> Self {
        let mut bvh = Self::default();
        let mut kept = Vec::with_capacity(corners.len());
        let mut boxes = Vec::with_capacity(corners.len());
        for (index, [a, b, c]) in corners.iter().enumerate() {
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                bvh.broken += 1;
                continue;
            }
            let area = (*b - *a).cross(*c - *a);
            if !(area.length_squared() > 0.0 && area.is_finite()) {
                // The square of a tiny area may underflow although the triangle has one: tested in f64.
                let (ab, ac) = ((*b - *a).as_dvec3(), (*c - *a).as_dvec3());
                if ab.cross(ac).length_squared() == 0.0 {
                    bvh.degenerate += 1;
                    continue;
                }
            }
            kept.push(index as u32);
            boxes.push((a.min(*b).min(*c), a.max(*b).max(*c)));
        }
        if kept.is_empty() {
            return bvh;
        }
        let mut build = Fold { corners, kept: &kept, boxes: &boxes, out: bvh };
        // Each level except the last leaves all children but one waiting.
        if most_in_one_place(&boxes) > CROWD || (WIDE - 1) * build.build_tree() >= STACK {
            build.out.nodes.clear();
            build.out.packets.clear();
            let mut order: Vec<u32> = (0..kept.len() as u32).collect();
            let mut tree = Vec::new();
            balanced(&boxes, &mut order, 0, &mut tree);
            build.fold(&tree, &order, Opens::Fullest);
        }
        build.out
    }
}

/// The largest number of boxes with the same centre.
fn most_in_one_place(boxes: &[(Vec3, Vec3)]) -> usize {
    if boxes.len() <= CROWD {
        return 0;
    }
    let mut centres: Vec<[u32; 3]> =
        boxes.iter().map(|(a, b)| (a + b).to_array().map(f32::to_bits)).collect();
    centres.sort_unstable();
    centres.chunk_by(|a, b| a == b).map(<[_]>::len).max().unwrap_or(0)
}

/// The rule that selects the branches of a binary tree that become children of an eight-wide node.
#[derive(Clone, Copy)]
pub(super) enum Opens {
    /// Selects the branches for which rays visit the fewest nodes: see [`Collapse`].
    Fewest,
    /// Opens the child with the most triangles first, so that the depth of the tree is a third of that of the
    /// binary tree.
    Fullest,
}

pub(super) struct Fold<'a> {
    pub(super) corners: &'a [[Vec3; 3]],
    pub(super) kept: &'a [u32],
    pub(super) boxes: &'a [(Vec3, Vec3)],
    pub(super) out: Bvh,
}

impl Fold<'_> {
    /// Builds the tree and returns its depth.
    fn build_tree(&mut self) -> usize {
        let large = self.kept.len() > 200_000;
        // The parameters of the preset "very slow", without splits and with cheaper reinsertion for large meshes. A
        // search depth of 1 keeps rays fast in meshes of mixed triangle sizes.
        let params = BvhBuildParams {
            pre_split: false,
            ploc_search_distance: PlocSearchDistance::Medium,
            search_depth_threshold: 1,
            reinsertion_batch_ratio: if large { 0.05 } else { 1.0 },
            post_collapse_reinsertion_batch_ratio_multiplier: 1.0,
            sort_precision: SortPrecision::U64,
            max_prims_per_leaf: 4,
            collapse_traversal_cost: 3.0,
        };
        let boxes: Vec<Aabb> = self.boxes.iter().map(|(l, h)| Aabb::new((*l).into(), (*h).into())).collect();
        let tree: Bvh2 = build_bvh2(&boxes, params, &mut std::time::Duration::default());
        let branches: Vec<Branch> = tree
            .nodes
            .iter()
            .map(|node| match node.prim_count {
                0 => Branch::Inner(node.first_index, node.first_index + 1),
                count => Branch::Leaf { first: node.first_index, count },
            })
            .collect();
        self.fold(&branches, &tree.primitive_indices, Opens::Fewest)
    }

    /// Converts a binary tree, whose root is its first branch, to an eight-wide tree. Returns the depth of the
    /// result.
    pub(super) fn fold(&mut self, tree: &[Branch], order: &[u32], opens: Opens) -> usize {
        // Boxes and numbers of triangles of every branch, children before parents, by an explicit stack.
        let mut bounds = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); tree.len()];
        let mut counts = vec![0; tree.len()];
        let mut visit = vec![(0_u32, false)];
        while let Some((at, done)) = visit.pop() {
            counts[at as usize] = match tree[at as usize] {
                Branch::Inner(left, right) => counts[left as usize] + counts[right as usize],
                Branch::Leaf { count, .. } => count,
            };
            bounds[at as usize] = match tree[at as usize] {
                Branch::Inner(left, right) if !done => {
                    visit.extend([(at, true), (left, false), (right, false)]);
                    continue;
                }
                Branch::Inner(left, right) => {
                    let ((a, b), (c, d)) = (bounds[left as usize], bounds[right as usize]);
                    (a.min(c), b.max(d))
                }
                Branch::Leaf { first, count } => order[first as usize..(first + count) as usize]
                    .iter()
                    .map(|&i| self.boxes[i as usize])
                    .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), (a, b)| (l.min(a), h.max(b))),
            };
        }
        self.out.bounds = Some(bounds[0]);
        let surface = |at: u32| {
            let size = bounds[at as usize].1 - bounds[at as usize].0;
            size.x * size.y + size.y * size.z + size.z * size.x
        };
        let collapse = match opens {
            Opens::Fewest => Some(Collapse::of(tree, surface)),
            Opens::Fullest => None,
        };
        let mut deepest = 0;
        let mut todo = vec![(0_u32, usize::MAX, 0, 1)];
        while let Some((at, parent, lane, depth)) = todo.pop() {
            deepest = deepest.max(depth);
            if let (Branch::Leaf { first, count }, true) = (tree[at as usize], parent != usize::MAX) {
                self.out.nodes[parent].children[lane] = self.leaf(order, first, count);
                continue;
            }
            let children = match &collapse {
                Some(collapse) => collapse.children(tree, at),
                None => fullest(tree, &counts, at),
            };
            let none = [[f32::INFINITY; WIDE], [f32::NEG_INFINITY; WIDE]];
            let mut node = Node { bounds: [none; 3], children: [LEAF; WIDE] };
            let index = self.out.nodes.len();
            for (lane, &child) in children.iter().enumerate() {
                let (low, high) = bounds[child as usize];
                for axis in 0..3 {
                    node.bounds[axis][0][lane] = low[axis];
                    node.bounds[axis][1][lane] = high[axis];
                }
                todo.push((child, index, lane, depth + 1));
            }
            self.out.nodes.push(node);
            if parent != usize::MAX {
                self.out.nodes[parent].children[lane] = index as u32;
            }
        }
        deepest
    }

    fn leaf(&mut self, order: &[u32], first: u32, count: u32) -> u32 {
        let start = self.out.packets.len() as u32;
        for chunk in order[first as usize..(first + count) as usize].chunks(4) {
            let mut packet = Packet::EMPTY;
            for (lane, &i) in chunk.iter().enumerate() {
                let id = self.kept[i as usize];
                packet.ids[lane] = id;
                for (corner, p) in packet.corners.iter_mut().zip(self.corners[id as usize]) {
                    for axis in 0..3 {
                        corner[axis][lane] = p[axis];
                    }
                }
            }
            self.out.packets.push(packet);
        }
        let packets = self.out.packets.len() as u32 - start;
        LEAF | (packets << LEAF_SHIFT) | start
    }
}

/// Selects the children of a node by [`Opens::Fullest`]: beginning with the branch itself, the inner branch with
/// the most triangles is replaced by its two children until there are eight children.
fn fullest(tree: &[Branch], counts: &[u32], node: u32) -> Vec<u32> {
    let mut children = vec![node];
    while children.len() < WIDE {
        let inner = |&&c: &&u32| matches!(tree[c as usize], Branch::Inner(..));
        let Some(&open) = children.iter().filter(inner).max_by_key(|&&c| counts[c as usize]) else { break };
        let Branch::Inner(left, right) = tree[open as usize] else { break };
        let place = children.iter().position(|&c| c == open).unwrap_or(0);
        children[place] = left;
        children.push(right);
    }
    children
}

/// Builds a binary tree by splitting at the median along the widest axis. It is not the fastest tree to trace, but
/// its depth is logarithmic in the number of triangles. Returns the index of its root.
pub(super) fn balanced(boxes: &[(Vec3, Vec3)], order: &mut [u32], first: u32, tree: &mut Vec<Branch>) -> u32 {
    let at = tree.len() as u32;
    if order.len() <= 4 {
        tree.push(Branch::Leaf { first, count: order.len() as u32 });
        return at;
    }
    tree.push(Branch::Inner(0, 0));
    let centre = |i: u32| boxes[i as usize].0 + boxes[i as usize].1;
    let (low, high) = order
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), &i| (l.min(centre(i)), h.max(centre(i))));
    let axis = (high - low).max_position();
    order.sort_by(|&a, &b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(&b)));
    let middle = order.len() / 2;
    let (left, right) = order.split_at_mut(middle);
    let left = balanced(boxes, left, first, tree);
    let right = balanced(boxes, right, first + middle as u32, tree);
    tree[at as usize] = Branch::Inner(left, right);
    at
}
