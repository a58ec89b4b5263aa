//! Being written.
#![allow(missing_docs, unused_variables, clippy::todo, clippy::missing_errors_doc)]
use super::inputs::{Library, References};
use super::kind::Request;
use super::plan::Failure;
use super::problem::Problem;
use super::report::Report;
use crate::num::Ctl;
#[derive(Debug, Clone)]
pub struct Plan;
impl Plan {
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        todo!()
    }
    pub fn references(&self) -> References {
        todo!()
    }
    pub fn request(&self) -> Request {
        todo!()
    }
    pub fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        todo!()
    }
}
