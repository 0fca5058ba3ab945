//! Robust kernels: the cost of an edge's squared error, limited for outliers.

/// How the squared error of an edge counts in the cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Kernel {
    /// As it is: for measurements that are never grossly wrong.
    #[default]
    Quadratic,
    /// Logarithmically beyond a scale: a measurement that others contradict pulls less and less.
    Cauchy {
        /// The scale, in standard deviations of the measurement; positive.
        sigmas: f64,
    },
}

impl Kernel {
    /// The cost of a squared error, with a kernel `scale` times as wide.
    pub(crate) fn cost(self, chi_squared: f64, scale: f64) -> f64 {
        match self {
            Self::Quadratic => chi_squared,
            Self::Cauchy { sigmas } => {
                let width = (sigmas * scale) * (sigmas * scale);
                // Rounding may leave a squared error slightly below zero.
                width * (chi_squared.max(0.0) / width).ln_1p()
            }
        }
    }

    /// One over the weight of an edge in iteratively reweighted least squares: the information is
    /// divided by it.
    pub(crate) fn inverse_weight(self, chi_squared: f64, scale: f64) -> f64 {
        match self {
            Self::Quadratic => 1.0,
            Self::Cauchy { sigmas } => 1.0 + chi_squared / ((sigmas * scale) * (sigmas * scale)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_weight_is_the_derivative_of_the_cost(
            chi_squared in 0.01..1e4,
            sigmas in 0.5..10.0,
            scale in 1.0..64.0,
        ) {
            let kernel = Kernel::Cauchy { sigmas };
            let step = 1e-4 * chi_squared;
            let slope = (kernel.cost(chi_squared + step, scale) - kernel.cost(chi_squared - step, scale)) / (2.0 * step);
            prop_assert!((slope * kernel.inverse_weight(chi_squared, scale) - 1.0).abs() < 1e-6);
        }
    }
}
