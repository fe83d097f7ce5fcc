//! Builds the eight-wide tree from triangles.

use engine::{Context, NodeError};
use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::ploc::{PlocSearchDistance, SortPrecision};
use obvhs::{BvhBuildParams, bvh2::Bvh2, bvh2::builder::build_bvh2};

use super::collapse::{Branch, Collapse};
use super::divide::{Division, divide, each};
use super::triangles::Packet;
use super::{Bvh, LEAF, LEAF_SHIFT, Node, STACK, WIDE};

/// Maximum number of triangles with the same centre for which `obvhs` is used. It joins one pair of such triangles
/// per pass, so its time is quadratic in their number.
const CROWD: usize = 1024;

/// Number of triangles above which a tree is built from pieces, on several threads.
const LARGE: usize = 200_000;
/// Number of triangles that one job prepares.
const PIECE: usize = 1 << 16;
/// Maximum number of levels of the tree above the pieces.
const UPPER: usize = 16;

impl Bvh {
    /// Builds a tree of triangles, given by their corners.
    pub fn build(corners: &[[Vec3; 3]]) -> Self {
        // Without a context nothing can fail.
        Self::built(None, corners).unwrap_or_default()
    }

    /// Builds the same tree as [`build`](Self::build), on the threads of a node. A large tree consists of pieces,
    /// whose number does not depend on the number of threads.
    ///
    /// # Errors
    /// If the run is cancelled.
    pub fn build_in(corners: &[[Vec3; 3]], cx: &Context) -> Result<Self, NodeError> {
        Self::built(Some(cx), corners)
    }

    fn built(cx: Option<&Context>, corners: &[[Vec3; 3]]) -> Result<Self, NodeError> {
        let sifted = each(cx, corners.len().div_ceil(PIECE), |piece| {
            let first = piece * PIECE;
            Sifted::of(&corners[first..corners.len().min(first + PIECE)], first)
        })?;
        let mut bvh = Self::default();
        let count = sifted.iter().map(|sifted| sifted.kept.len()).sum();
        let (mut kept, mut boxes) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for sifted in sifted {
            bvh.broken += sifted.broken;
            bvh.degenerate += sifted.degenerate;
            kept.extend(sifted.kept);
            boxes.extend(sifted.boxes);
        }
        if kept.is_empty() {
            return Ok(bvh);
        }
        if kept.len() <= LARGE {
            let build = Fold { corners, kept: &kept, boxes: &boxes, out: bvh };
            return Ok(build.built(STACK / (WIDE - 1), false));
        }
        let Division { pieces, tree } = divide(cx, &boxes)?;
        let built = each(cx, pieces.len(), |index| {
            let of = |at: &u32| (kept[*at as usize], boxes[*at as usize]);
            let (kept, boxes): (Vec<_>, Vec<_>) = pieces[index].iter().map(of).unzip();
            let build = Fold { corners, kept: &kept, boxes: &boxes, out: Self::default() };
            build.built(STACK / (WIDE - 1) - UPPER, true)
        })?;
        drop((kept, boxes));
        bvh.join(built, &tree);
        Ok(bvh)
    }

    /// Appends the nodes of finished pieces below the nodes of a binary tree. The leaves of `tree` are indices into
    /// `pieces`.
    fn join(&mut self, pieces: Vec<Self>, tree: &[Branch]) {
        let boxes: Vec<_> = pieces.iter().map(|piece| piece.bounds.unwrap_or_default()).collect();
        let order: Vec<u32> = (0..pieces.len() as u32).collect();
        let counts: Vec<u32> = pieces.iter().map(|piece| piece.nodes.len() as u32).collect();
        let mut top = Fold { corners: &[], kept: &[], boxes: &boxes, out: std::mem::take(self) };
        // The index of the first node of a piece depends on the number of nodes above the pieces, which is known
        // only after the fold. Until then, a child holds the index of the piece.
        top.fold_onto(tree, &order, Opens::Fewest, |_, piece| LEAF | piece[0]);
        *self = top.out;
        let above = self.nodes.len() as u32;
        let mut starts = Vec::with_capacity(pieces.len());
        let mut next = above;
        for count in &counts {
            starts.push(next);
            next += count;
        }
        for node in &mut self.nodes {
            for (lane, child) in node.children.iter_mut().enumerate() {
                // Lanes without a child have empty bounds.
                if *child & LEAF != 0 && node.bounds[0][0][lane] <= node.bounds[0][1][lane] {
                    *child = starts[(*child & !LEAF) as usize];
                }
            }
        }
        self.nodes.reserve_exact(counts.iter().map(|count| *count as usize).sum());
        self.packets.reserve_exact(pieces.iter().map(|piece| piece.packets.len()).sum());
        for (piece, start) in pieces.into_iter().zip(starts) {
            let packets = self.packets.len() as u32;
            self.nodes.extend(piece.nodes.into_iter().map(|mut node| {
                for child in &mut node.children {
                    // The index of the first packet is in the lowest bits.
                    *child += if *child & LEAF == 0 { start } else { packets };
                }
                node
            }));
            self.packets.extend(piece.packets);
        }
    }
}

/// The triangles of a piece that can be hit, and the number of the other triangles.
struct Sifted {
    kept: Vec<u32>,
    boxes: Vec<(Vec3, Vec3)>,
    broken: u64,
    degenerate: u64,
}

impl Sifted {
    /// Selects triangles from `corners`, a consecutive part of a mesh. `first` is the index in the mesh of the
    /// first of these triangles.
    fn of(corners: &[[Vec3; 3]], first: usize) -> Self {
        let (kept, boxes) = (Vec::with_capacity(corners.len()), Vec::with_capacity(corners.len()));
        let mut sifted = Self { kept, boxes, broken: 0, degenerate: 0 };
        for (index, [a, b, c]) in corners.iter().enumerate() {
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                sifted.broken += 1;
                continue;
            }
            let area = (*b - *a).cross(*c - *a);
            if !(area.length_squared() > 0.0 && area.is_finite()) {
                // The square of a tiny area may underflow although the triangle has one: tested in f64.
                let (ab, ac) = ((*b - *a).as_dvec3(), (*c - *a).as_dvec3());
                if ab.cross(ac).length_squared() == 0.0 {
                    sifted.degenerate += 1;
                    continue;
                }
            }
            sifted.kept.push((first + index) as u32);
            sifted.boxes.push((a.min(*b).min(*c), a.max(*b).max(*c)));
        }
        sifted
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
    /// Opens the child with the most triangles first, so that the tree has a third of the depth of the binary tree.
    Fullest,
}

pub(super) struct Fold<'a> {
    pub(super) corners: &'a [[Vec3; 3]],
    pub(super) kept: &'a [u32],
    pub(super) boxes: &'a [(Vec3, Vec3)],
    pub(super) out: Bvh,
}

impl Fold<'_> {
    /// Builds a tree of at most `deepest` levels. `is_piece` is true if the tree becomes a piece of a large tree.
    pub(super) fn built(mut self, deepest: usize, is_piece: bool) -> Bvh {
        // Each level except the last leaves all children but one waiting.
        if most_in_one_place(self.boxes) > CROWD || self.build_tree(is_piece) > deepest {
            self.out.nodes.clear();
            self.out.packets.clear();
            let mut order: Vec<u32> = (0..self.kept.len() as u32).collect();
            let mut tree = Vec::new();
            balanced(self.boxes, &mut order, 0, &mut tree);
            self.fold(&tree, &order, Opens::Fullest);
        }
        self.out
    }

    /// Builds the tree and returns its depth. `large` is true if the tree becomes a piece of a large tree.
    fn build_tree(&mut self, large: bool) -> usize {
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
        self.fold_onto(tree, order, opens, Self::leaf)
    }

    /// Same as [`fold`](Self::fold), but `leaf` returns the child that stands for the items of a leaf.
    fn fold_onto(
        &mut self,
        tree: &[Branch],
        order: &[u32],
        opens: Opens,
        leaf: impl Fn(&mut Self, &[u32]) -> u32,
    ) -> usize {
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
                let child = leaf(self, &order[first as usize..(first + count) as usize]);
                self.out.nodes[parent].children[lane] = child;
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

    fn leaf(&mut self, items: &[u32]) -> u32 {
        let start = self.out.packets.len() as u32;
        for chunk in items.chunks(4) {
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
/// the most triangles is replaced with its two children until there are eight children.
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
