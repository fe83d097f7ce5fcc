//! Primaries of RGB colour spaces: chromaticities, and the matrices between them.

/// A 3x3 matrix in row-major order, for column vectors.
pub type Matrix = [[f64; 3]; 3];

/// CIE 1931 xy chromaticities of the primaries and the white of an RGB space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primaries {
    /// Chromaticity (x, y) of red.
    pub red: [f64; 2],
    /// Chromaticity (x, y) of green.
    pub green: [f64; 2],
    /// Chromaticity (x, y) of blue.
    pub blue: [f64; 2],
    /// Chromaticity (x, y) of white, RGB = (1, 1, 1).
    pub white: [f64; 2],
}

/// Chromaticity of the white of CIE standard illuminant D65, as rounded in ITU-R BT.709.
pub const D65: [f64; 2] = [0.3127, 0.3290];

const fn primaries(red: [f64; 2], green: [f64; 2], blue: [f64; 2], white: [f64; 2]) -> Primaries {
    Primaries { red, green, blue, white }
}

/// ITU-R BT.709 and IEC 61966-2-1 (sRGB).
pub const REC709: Primaries = primaries([0.64, 0.33], [0.30, 0.60], [0.15, 0.06], D65);
/// Display P3: the primaries of SMPTE RP 431-2 with the white of D65.
pub const P3_D65: Primaries = primaries([0.680, 0.320], [0.265, 0.690], [0.150, 0.060], D65);
/// ITU-R BT.2020.
pub const REC2020: Primaries = primaries([0.708, 0.292], [0.170, 0.797], [0.131, 0.046], D65);
/// White of the ACES spaces, near D60 (SMPTE ST 2065-1).
const ACES_WHITE: [f64; 2] = [0.32168, 0.33767];
/// AP0, the primaries of ACES2065-1 (SMPTE ST 2065-1).
pub const AP0: Primaries = primaries([0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.0770], ACES_WHITE);
/// AP1, the primaries of ACEScg and ACEScct (Academy S-2014-004).
pub const AP1: Primaries = primaries([0.713, 0.293], [0.165, 0.830], [0.128, 0.044], ACES_WHITE);
/// ARRI Wide Gamut 3, for LogC3 (ARRI, *Alexa LogC curve*, 2017).
pub const ARRI_WIDE_GAMUT_3: Primaries =
    primaries([0.6840, 0.3130], [0.2210, 0.8480], [0.0861, -0.1020], D65);
/// ARRI Wide Gamut 4, for LogC4 (ARRI, *LogC4 specification*, 2022).
pub const ARRI_WIDE_GAMUT_4: Primaries =
    primaries([0.7347, 0.2653], [0.1424, 0.8576], [0.0991, -0.0308], D65);
/// S-Gamut3 (Sony, *Technical summary for S-Gamut3.Cine/S-Log3 and S-Gamut3/S-Log3*).
pub const S_GAMUT3: Primaries = primaries([0.730, 0.280], [0.140, 0.855], [0.100, -0.050], D65);
/// S-Gamut3.Cine, from the same document as [`S_GAMUT3`].
pub const S_GAMUT3_CINE: Primaries = primaries([0.766, 0.275], [0.225, 0.800], [0.089, -0.087], D65);
/// V-Gamut (Panasonic, *V-Log/V-Gamut reference manual*, 2014).
pub const V_GAMUT: Primaries = primaries([0.730, 0.280], [0.165, 0.840], [0.100, -0.030], D65);
/// DaVinci Wide Gamut (Blackmagic Design, *DaVinci Resolve 17: wide gamut intermediate*, 2021).
pub const DAVINCI_WIDE_GAMUT: Primaries =
    primaries([0.8000, 0.3130], [0.1682, 0.9877], [0.0790, -0.1155], D65);

impl Primaries {
    /// Matrix from linear RGB to CIE XYZ, with luminance 1 for white (SMPTE RP 177).
    pub fn xyz(&self) -> Matrix {
        let columns = [self.red, self.green, self.blue].map(tristimulus);
        let basis = transposed(columns);
        let weights = product_vector(&inverse(&basis), tristimulus(self.white));
        basis.map(|row| std::array::from_fn(|column| row[column] * weights[column]))
    }

    /// Matrix from linear RGB of these primaries to that of `to`. If the whites differ, colours are adapted with
    /// the Bradford transform, so that white stays white; ICC.1:2022 and the ACES configurations of OpenColorIO
    /// use the same transform. Each row sums to 1 within rounding.
    pub fn to(&self, to: &Self) -> Matrix {
        self.adapted_to(to, &BRADFORD)
    }

    /// Like [`to`](Self::to), with the cone responses of a given adaptation transform.
    pub fn adapted_to(&self, to: &Self, cones: &Matrix) -> Matrix {
        if self == to {
            return IDENTITY;
        }
        let adapted = if self.white == to.white {
            self.xyz()
        } else {
            product(&adaptation(cones, self.white, to.white), &self.xyz())
        };
        product(&inverse(&to.xyz()), &adapted)
    }
}

/// The identity matrix.
pub const IDENTITY: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Cone responses of the Bradford transform (ICC.1:2022, annex E).
const BRADFORD: Matrix = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];

/// Cone responses of CAT02 (CIE 159:2004), which the makers of some cameras use between D65 and the white of ACES.
pub const CAT02: Matrix = [[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]];

/// Matrix of the Bradford transform, which adapts XYZ colours from the white `from` to the white `to`, both given as
/// chromaticities.
pub fn bradford(from: [f64; 2], to: [f64; 2]) -> Matrix {
    adaptation(&BRADFORD, from, to)
}

/// Matrix that adapts XYZ colours from the white `from` to the white `to` by scaling cone responses.
fn adaptation(cones: &Matrix, from: [f64; 2], to: [f64; 2]) -> Matrix {
    let [from, to] = [from, to].map(|white| product_vector(cones, tristimulus(white)));
    let scaled: Matrix = std::array::from_fn(|row| cones[row].map(|response| response * to[row] / from[row]));
    product(&inverse(cones), &scaled)
}

/// XYZ of luminance 1 with the given chromaticity.
fn tristimulus([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

/// The product `a b`.
pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|row| {
        std::array::from_fn(|column| {
            a[row][0] * b[0][column] + a[row][1] * b[1][column] + a[row][2] * b[2][column]
        })
    })
}

/// The product of a matrix and a column vector.
#[inline]
pub fn product_vector(m: &Matrix, v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn transposed(m: Matrix) -> Matrix {
    std::array::from_fn(|row| std::array::from_fn(|column| m[column][row]))
}

/// The inverse of a regular matrix, from its cofactors.
pub fn inverse(m: &Matrix) -> Matrix {
    let cofactor = |row: usize, column: usize| {
        let (a, b) = ((row + 1) % 3, (row + 2) % 3);
        let (c, d) = ((column + 1) % 3, (column + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant = m[0][0] * cofactor(0, 0) + m[0][1] * cofactor(0, 1) + m[0][2] * cofactor(0, 2);
    std::array::from_fn(|row| std::array::from_fn(|column| cofactor(column, row) / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn largest_difference(a: &Matrix, b: &Matrix) -> f64 {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// Compares with the matrices of OpenColorIO 2.6.0 (`ACES-AP1_to_LINEAR-REC709_BFD`,
    /// `ACES-AP0_to_CIE-XYZ-D65_BFD`), which are stored there as 32-bit floats.
    #[test]
    fn aces_matrices_equal_those_of_opencolorio() {
        let ap1_to_rec709 = [
            [1.705_050_95, -0.621_792_14, -0.083_258_87],
            [-0.130_256_41, 1.140_804_77, -0.010_548_32],
            [-0.024_003_36, -0.128_968_97, 1.152_972_34],
        ];
        assert!(largest_difference(&AP1.to(&REC709), &ap1_to_rec709) < 2e-7);
        let ap0_to_xyz = [
            [0.938_279_87, -0.004_451_45, 0.016_627_52],
            [0.337_368_91, 0.729_521_57, -0.066_890_46],
            [0.001_173_95, -0.003_710_71, 1.091_594_46],
        ];
        let own = product(&bradford(AP0.white, D65), &AP0.xyz());
        assert!(largest_difference(&own, &ap0_to_xyz) < 2e-7);
    }

    #[test]
    fn matrices_of_each_pair_are_inverse_and_keep_white() {
        let all = [
            REC709,
            P3_D65,
            REC2020,
            AP0,
            AP1,
            ARRI_WIDE_GAMUT_3,
            ARRI_WIDE_GAMUT_4,
            S_GAMUT3,
            S_GAMUT3_CINE,
            V_GAMUT,
            DAVINCI_WIDE_GAMUT,
        ];
        for a in &all {
            for b in &all {
                let there = a.to(b);
                assert!(largest_difference(&product(&b.to(a), &there), &IDENTITY) < 1e-13);
                assert!(product_vector(&there, [1.0; 3]).iter().all(|v| (v - 1.0).abs() < 1e-14));
            }
            let luminance = product_vector(&a.xyz(), [1.0; 3])[1];
            assert!((luminance - 1.0).abs() < 1e-14);
        }
    }
}
