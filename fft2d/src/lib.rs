//! Two-dimensional Fourier transforms of real images.
//!
//! A crate of its own, as the transforms are generic code that takes most of a minute to build: where it is used, it would be built again
//! with each change and for each test.
//!
//! ```
//! use fft2d::Fft2;
//!
//! // Shifts an image of 8 x 4 pixels by (2, 1): the product of its spectrum with that of a point there.
//! let (mut image, mut point) = (vec![0.0; 32], vec![0.0; 32]);
//! (image[0], point[8 + 2]) = (1.0, 1.0);
//! let mut fft = Fft2::new(8, 4);
//! let (mut spectrum, mut shift, mut shifted) = (Vec::new(), Vec::new(), Vec::new());
//! fft.forward(&mut image, &mut spectrum);
//! fft.forward(&mut point, &mut shift);
//! spectrum.iter_mut().zip(&shift).for_each(|(value, by)| *value *= by);
//! fft.inverse(&mut spectrum, &mut shifted);
//! assert!((shifted[8 + 2] / 32.0 - 1.0).abs() < 1e-5);
//! ```

pub use rustfft::num_complex::Complex;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Transforms for images of one size. A spectrum is stored transposed: `height` values for each of the
/// `width / 2 + 1` horizontal frequencies.
pub struct Fft2 {
    width: usize,
    height: usize,
    along: Arc<dyn RealToComplex<f32>>,
    along_back: Arc<dyn ComplexToReal<f32>>,
    across: Arc<dyn Fft<f32>>,
    across_back: Arc<dyn Fft<f32>>,
    rows: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
}

/// The next even size that factors into 2, 3 and 5: transforms of such sizes are fast.
pub fn fast_size(least: usize) -> usize {
    let smooth = |mut n: usize| {
        for factor in [2, 3, 5] {
            while n.is_multiple_of(factor) {
                n /= factor;
            }
        }
        n == 1
    };
    (least.max(2)..).find(|n| n.is_multiple_of(2) && smooth(*n)).unwrap_or(least)
}

impl Fft2 {
    /// Plans the transforms for images of `width` x `height`; the width is even.
    pub fn new(width: usize, height: usize) -> Self {
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        let (along, along_back) = (real.plan_fft_forward(width), real.plan_fft_inverse(width));
        let (across, across_back) = (complex.plan_fft_forward(height), complex.plan_fft_inverse(height));
        let longest = [
            along.get_scratch_len(),
            along_back.get_scratch_len(),
            across.get_inplace_scratch_len(),
            across_back.get_inplace_scratch_len(),
        ];
        let scratch = vec![Complex::default(); longest.into_iter().max().unwrap_or(0)];
        let rows = vec![Complex::default(); (width / 2 + 1) * height];
        Self { width, height, along, along_back, across, across_back, rows, scratch }
    }

    /// Number of values in a spectrum.
    pub fn spectrum_len(&self) -> usize {
        self.rows.len()
    }

    /// Transforms an image into its spectrum; the image is overwritten.
    pub fn forward(&mut self, image: &mut [f32], spectrum: &mut Vec<Complex<f32>>) {
        let half = self.width / 2 + 1;
        for (row, out) in image.chunks_exact_mut(self.width).zip(self.rows.chunks_exact_mut(half)) {
            let done =
                self.along.process_with_scratch(row, out, &mut self.scratch[..self.along.get_scratch_len()]);
            debug_assert!(done.is_ok());
        }
        spectrum.clear();
        spectrum.resize(self.rows.len(), Complex::default());
        transpose(&self.rows, half, spectrum);
        self.across.process_with_scratch(spectrum, &mut self.scratch);
    }

    /// Transforms a spectrum back into `width * height` times its image; the spectrum is overwritten.
    pub fn inverse(&mut self, spectrum: &mut [Complex<f32>], image: &mut Vec<f32>) {
        let half = self.width / 2 + 1;
        self.across_back.process_with_scratch(spectrum, &mut self.scratch);
        transpose(spectrum, self.height, &mut self.rows);
        image.clear();
        image.resize(self.width * self.height, 0.0);
        for (row, out) in self.rows.chunks_exact_mut(half).zip(image.chunks_exact_mut(self.width)) {
            // The spectrum of a real image is real there; rounding has made it almost real.
            row[0].im = 0.0;
            row[half - 1].im = 0.0;
            let scratch = &mut self.scratch[..self.along_back.get_scratch_len()];
            let done = self.along_back.process_with_scratch(row, out, scratch);
            debug_assert!(done.is_ok());
        }
    }
}

/// Transposes rows of `width` into columns, in blocks so that both sides stay in the cache.
fn transpose(from: &[Complex<f32>], width: usize, to: &mut [Complex<f32>]) {
    const BLOCK: usize = 16;
    let height = from.len() / width;
    for y0 in (0..height).step_by(BLOCK) {
        for x0 in (0..width).step_by(BLOCK) {
            for y in y0..(y0 + BLOCK).min(height) {
                for x in x0..(x0 + BLOCK).min(width) {
                    to[x * height + y] = from[y * width + x];
                }
            }
        }
    }
}
