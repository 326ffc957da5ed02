//! Activation functions, with the same bits on every machine and fast in vector registers.

/// Activation function of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// The sum itself.
    Identity,
    /// The larger of the sum and zero.
    Relu,
    /// The hyperbolic tangent.
    Tanh,
}

impl Activation {
    /// Applies the function to each number.
    #[inline(always)]
    pub(crate) fn apply(self, numbers: &mut [f32]) {
        match self {
            Activation::Identity => {}
            Activation::Relu => numbers.iter_mut().for_each(|number| *number = rectify(*number)),
            Activation::Tanh => numbers.iter_mut().for_each(|number| *number = tanh(*number)),
        }
    }

    /// Turns gradients of the function's outputs into gradients of its inputs. The derivative is computed from the
    /// outputs; at zero it is zero for [`Activation::Relu`].
    pub(crate) fn backward(self, outputs: &[f32], gradient: &mut [f32]) {
        let pairs = gradient.iter_mut().zip(outputs);
        match self {
            Activation::Identity => {}
            Activation::Relu => {
                pairs.for_each(|(derivative, &output)| {
                    *derivative = if output > 0.0 { *derivative } else { 0.0 }
                });
            }
            Activation::Tanh => {
                pairs.for_each(|(derivative, &output)| *derivative *= 1.0 - output * output)
            }
        }
    }
}

/// Returns the number if it is positive, and otherwise zero. Unlike `f32::max`, it fixes the sign of zero.
#[inline(always)]
pub(crate) fn rectify(number: f32) -> f32 {
    if number > 0.0 { number } else { 0.0 }
}

/// Input beyond which `tanh` is one up to the last bit in single precision.
const TANH_SATURATION: f32 = 9.0;

/// Odd coefficients of the numerator, from x to x^9, of the rational fit to tanh on [-9, 9].
const TANH_NUMERATOR: [f32; 5] =
    [0.999_999_98, 0.133_810_39, 3.495_603_4e-3, 2.060_930_4e-5, 1.335_491_4e-8];

/// Even coefficients of the denominator, from 1 to x^8.
const TANH_DENOMINATOR: [f32; 5] =
    [1.0, 0.467_143_55, 2.587_704_2e-2, 3.285_658_5e-4, 7.776_669e-7];

/// Computes the hyperbolic tangent by a rational function, with a relative error below 4e-7.
///
/// The coefficients are a minimax fit by reweighted least squares (relative error 2e-8); the remaining error comes
/// from single precision.
#[inline(always)]
pub(crate) fn tanh(number: f32) -> f32 {
    let number = number.clamp(-TANH_SATURATION, TANH_SATURATION);
    let square = number * number;
    let polynomial = |coefficients: [f32; 5]| {
        let [c0, c1, c2, c3, c4] = coefficients;
        let tail = c4.mul_add(square, c3).mul_add(square, c2);
        tail.mul_add(square, c1).mul_add(square, c0)
    };
    (number * polynomial(TANH_NUMERATOR) / polynomial(TANH_DENOMINATOR)).clamp(-1.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tanh_is_within_its_stated_error() {
        let mut worst: f64 = 0.0;
        for step in -1_200_000..=1_200_000_i32 {
            let number = step as f32 * 1e-5;
            let exact = libm::tanh(f64::from(number));
            let error = (f64::from(tanh(number)) - exact).abs();
            worst = worst.max(if exact == 0.0 { error } else { error / exact.abs() });
        }
        assert!(worst < 4e-7, "the largest relative error is {worst:e}");
        assert_eq!(tanh(0.0), 0.0);
        assert_eq!(tanh(50.0), 1.0);
        assert_eq!(tanh(-50.0), -1.0);
        assert!(tanh(f32::NAN).is_nan());
    }
}
