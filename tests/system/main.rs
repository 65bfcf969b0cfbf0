//! Tests of the whole project: the crate graph, the rules of the sources and texts, every recipe, and the program as
//! users run it.

mod architecture;
mod ci_scripts;
mod command_line;
mod crashes;
mod damage;
mod data;
mod device;
mod dialect;
mod editing;
mod evidence;
mod fetch;
mod first_day;
mod imports;
mod kernels;
mod links;
mod numerics;
mod pages;
mod papers;
mod prepare;
mod product;
mod published;
mod readings;
mod recipe_keys;
mod recipes;
mod repetition;
mod search;
mod slurm;
mod sources;
mod tidy;
mod tools;
mod verbs;
