//! What a trial and its lines give, and a cluster of feedforward denominators at the lines.

use super::tree::{DIRECTIONS, Node};
use crate::identify::problem::Problem;
use num_complex::Complex64;

/// What a trial and its lines give.
#[derive(Debug)]
pub(super) struct Lines {
    pub count: usize,
    pub even: usize,
    pub odd: usize,
    /// Per line: Re E, Im E, Re G, Im G, √weight, and Re and Im of the rotation of the half-bases.
    pub constants: Vec<[f64; 7]>,
    /// Per line: the products of the Gram matrices' lower triangles, row by row, the real half first.
    pub products: Vec<f64>,
    /// Per line: the basis functions.
    pub functions: Vec<f64>,
}

impl Lines {
    pub(super) fn new(problem: &Problem) -> Self {
        let (even, odd) = (problem.basis().even(), problem.basis().odd());
        let (mut constants, mut products, mut functions) = (Vec::new(), Vec::new(), Vec::new());
        for (k, line) in problem.lines().iter().enumerate() {
            let error = 1.0 - line.response;
            // The numerator is turned back by this angle from where it splits into halves.
            let rotation = Complex64::from_polar(1.0, -problem.basis().rotation(line.omega_rad_s));
            constants.push([
                error.re,
                error.im,
                line.plant.re,
                line.plant.im,
                line.weight.sqrt(),
                rotation.re,
                rotation.im,
            ]);
            for part in [even, odd] {
                for i in 0..part.len() {
                    products.extend((0..=i).map(|j| part.values[i][k] * part.values[j][k]));
                }
                functions.extend(part.values.iter().map(|v| v[k]));
            }
        }
        Self { count: problem.lines().len(), even: even.len(), odd: odd.len(), constants, products, functions }
    }

    pub(super) fn product_count(&self) -> usize {
        (self.even * (self.even + 1) + self.odd * (self.odd + 1)) / 2
    }
}

/// A cluster of feedforward denominators at the lines.
#[derive(Debug)]
pub(super) struct Denominators {
    /// Per line: Re and Im of 1/D, the radius of δ, Re and Im of each direction.
    pub rows: Vec<[f64; 3 + 2 * DIRECTIONS]>,
    /// Per line: the products of [`Lines`], over |D|².
    pub products: Vec<f64>,
    pub low: [f64; DIRECTIONS],
    pub high: [f64; DIRECTIONS],
    pub spread: f64,
    /// Per line: what the directions leave over; empty where that is rounding.
    pub remainder: Vec<f64>,
}

/// Remainders below this share of the radius are rounding, which the slack covers.
const LINEAR: f64 = 1e-12;

impl Denominators {
    pub(super) fn new(lines: &Lines, node: &Node) -> Self {
        let (mut rows, mut products) = (Vec::new(), Vec::new());
        for k in 0..lines.count {
            let inverse = node.centre[k].inv();
            let mut row = [0.0; 3 + 2 * DIRECTIONS];
            (row[0], row[1], row[2]) = (inverse.re, inverse.im, node.radius[k]);
            for m in 0..DIRECTIONS {
                let direction = node.directions[m * lines.count + k];
                (row[3 + 2 * m], row[4 + 2 * m]) = (direction.re, direction.im);
            }
            rows.push(row);
            let (u, width) = (inverse.norm_sqr(), lines.product_count());
            products.extend(lines.products[k * width..(k + 1) * width].iter().map(|p| p * u));
        }
        let linear = node.remainder.iter().zip(&node.radius).all(|(left, radius)| *left <= LINEAR * (1.0 + radius));
        let remainder = if linear { Vec::new() } else { node.remainder.clone() };
        Self { rows, products, low: node.low, high: node.high, spread: node.spread, remainder }
    }
}
