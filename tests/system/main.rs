//! What holds of the whole: the crate graph, the house rules, every recipe, and the product as its users run it.

mod architecture;
mod command_line;
mod crashes;
mod damage;
mod data;
mod device;
mod editing;
mod evidence;
mod numerics;
mod product;
mod readings;
mod recipe_keys;
mod recipes;
mod repetition;
mod sources;
mod tidy;
mod verbs;
