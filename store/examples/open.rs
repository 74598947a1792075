//! What a page file holds, without its pages: `cargo run -p trex-store --example open [-- FILE.trex]`. Without a file
//! it builds a small one for itself.
#![allow(clippy::print_stdout)]

#[path = "support/tiny.rs"]
mod tiny;

use trex_store::{Budget, Error, PageFile};

fn main() -> Result<(), Error> {
    let model = tiny::model()?;
    // Tables are leased from a ledger; a page file that does not fit is refused with what it needs.
    let budget = Budget::new(256 << 20);
    let file = PageFile::open(&model.path, &budget)?;
    let block = file.superblock();
    println!("{} triangles in {} pages", block.triangle_count, file.pages().len());
    println!("box {:?} to {:?}", block.bounds.lo, block.bounds.hi);
    println!("every vertex within {:e} of the input's", block.error_bound);
    println!("{} bytes of tables in memory, {} leased", file.resident_table_bytes(), budget.used_bytes());
    for (page, entry) in file.pages().iter().enumerate().take(3) {
        println!("page {page}: {} triangles in {} bytes on disk", entry.triangle_count, entry.stored_bytes);
    }
    Ok(())
}
