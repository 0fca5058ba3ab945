//! What goes in comes out, and sizes that are fast. Beside the crate, as unit tests would build the transforms once more.

use fft2d::{Fft2, fast_size};

#[test]
fn the_inverse_restores_the_image() {
    let (width, height) = (12, 10);
    let image: Vec<f32> = (0..width * height).map(|i| ((i * 37) % 11) as f32).collect();
    let mut fft = Fft2::new(width, height);
    let (mut spectrum, mut back) = (Vec::new(), Vec::new());
    fft.forward(&mut image.clone(), &mut spectrum);
    fft.inverse(&mut spectrum, &mut back);
    for (before, after) in image.iter().zip(&back) {
        assert!((before - after / (width * height) as f32).abs() < 1e-4);
    }
}

#[test]
fn fast_sizes_are_even_and_factor_into_small_primes() {
    assert_eq!([1, 7, 121, 640].map(fast_size), [2, 8, 128, 640]);
}
