//! Instructions a call of the elementary functions, beside the libraries they were chosen over.
use crate::count::Counter;
use control_core::{Scalar, math};
use core::f32::consts::PI;
use core::hint::black_box;
use cortex_m_semihosting::hprintln;
use micromath::F32Ext;

/// Arguments a function: enough to take every branch of every implementation.
const ARGUMENTS: u16 = 200;

type Unary = fn(f32) -> f32;
type Binary = fn(f32, f32) -> f32;

/// A function, the range of its arguments, and the core's, libm's and micromath's version of it.
const UNARY: [(&str, (f32, f32), [Unary; 3]); 5] = [
    ("tanh", (-6.0, 6.0), [math::tanh, libm::tanhf, tanh_by_exp]),
    ("asin", (-0.95, 0.95), [asin, libm::asinf, F32Ext::asin]),
    ("sqrt", (0.0, 100.0), [Scalar::sqrt, libm::sqrtf, F32Ext::sqrt]),
    ("sin", (-PI, PI), [math::sin, libm::sinf, F32Ext::sin]),
    ("cos", (-PI, PI), [math::cos, libm::cosf, F32Ext::cos]),
];

/// As above; its points lie on a diamond round the origin.
const ATAN2: [Binary; 3] = [math::atan2, libm::atan2f, F32Ext::atan2];

/// The core's, which gives the cosine as well.
fn asin(x: f32) -> f32 {
    let (angle, cosine) = math::asin_and_cos(x);
    black_box(cosine);
    angle
}

/// micromath has no tanh; this is what its exp makes of it.
fn tanh_by_exp(x: f32) -> f32 {
    let square = F32Ext::exp(2.0 * x);
    (square - 1.0) / (square + 1.0)
}

/// Prints one line a function.
pub(crate) fn print(counter: &Counter) {
    for (name, range, versions) in UNARY {
        print_line(name, versions.map(|function| unary(counter, function, range)));
    }
    print_line("atan2", ATAN2.map(|function| binary(counter, function)));
}

fn print_line(name: &str, [core, libm, micromath]: [u32; 3]) {
    hprintln!("math function={} core={} libm={} micromath={}", name, core, libm, micromath);
}

/// The worst call of a sweep.
fn unary(counter: &Counter, function: Unary, range: (f32, f32)) -> u32 {
    let function = black_box(function);
    let cost = |x| counter.instructions(|| function(x)).0;
    sweep(range).map(cost).max().unwrap_or(0)
}

fn binary(counter: &Counter, function: Binary) -> u32 {
    let function = black_box(function);
    let cost = |x: f32| {
        let y = 1.0 - x.abs();
        let (upper, lower) = (|| function(y, x), || function(-y, x));
        counter.instructions(upper).0.max(counter.instructions(lower).0)
    };
    sweep((-1.0, 1.0)).map(cost).max().unwrap_or(0)
}

/// Evenly spaced arguments, both ends included.
fn sweep((low, high): (f32, f32)) -> impl Iterator<Item = f32> {
    (0..=ARGUMENTS).map(move |i| black_box(low + (high - low) * f32::from(i) / f32::from(ARGUMENTS)))
}
