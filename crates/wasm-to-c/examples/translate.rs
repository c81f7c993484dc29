//! Translates a WebAssembly module to `model.h` and `model.c` in a folder: `translate MODULE FOLDER`.

use std::{env, error::Error, fs, path::Path};

use wasm_to_c::{Options, translate};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [module, folder] = arguments.as_slice() else {
        return Err("usage: translate MODULE FOLDER".into());
    };
    let options = Options { prefix: "model_".into(), description: module.clone() };
    let files = translate(&fs::read(module)?, &options)?;
    fs::write(Path::new(folder).join("model.h"), files.header)?;
    fs::write(Path::new(folder).join("model.c"), files.source)?;
    println!("{} bytes of memory, imports: {:?}", files.memory_size, files.imports);
    Ok(())
}
