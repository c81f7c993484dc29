//! The section of global variables: moving the variables of an object file there, and the function that finds it.

use object::LittleEndian as LE;

use object::elf::{FileHeader64, SectionHeader64};
use object::pe::{ImageFileHeader, ImageSectionHeader};
use object::pod::{from_bytes, from_bytes_mut};
use object::{elf, pe};

/// The format of object files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    Elf,
    Coff,
}

/// The section of a library.
pub struct Section {
    format: Format,
    library: String,
    /// The name; in COFF, linkers sort the parts of the section by what follows a `$`.
    name: String,
}

impl Section {
    pub fn new(format: Format, library: &str) -> Self {
        let name = match format {
            // A C identifier, so that the linker defines where it starts and stops.
            Format::Elf => format!("fmu_globals_{library}"),
            // With a `$` and a letter, the 8 characters that a name in COFF can have.
            Format::Coff => {
                let hash = library.bytes().fold(0x811c_9dc5_u32, |hash, byte| {
                    (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
                });
                format!(".g{:04x}", hash >> 16)
            }
        };
        Self { format, library: library.to_owned(), name }
    }

    /// The source of a function in C that tells where the variables and the loaded library are.
    pub fn accessor(&self, hash: u64) -> String {
        let text = match self.format {
            Format::Elf => include_str!("elf.c"),
            Format::Coff => include_str!("coff.c"),
        };
        (text.replace("SECTION", &self.name).replace("LIBRARY", &self.library))
            .replace("HASH", &hash.to_string())
    }

    /// An object file with its variables in the section.
    ///
    /// # Errors
    /// It is no object file of this format.
    pub fn moved(&self, object: Vec<u8>) -> Result<Vec<u8>, String> {
        match self.format {
            Format::Elf => self.moved_in_elf(object),
            Format::Coff => self.moved_in_coff(object),
        }
        .ok_or_else(|| "it is not an object file of the target".to_owned())
    }

    fn moved_in_elf(&self, mut object: Vec<u8>) -> Option<Vec<u8>> {
        let (header, _) = from_bytes::<FileHeader64<LE>>(&object).ok()?;
        if header.e_ident.magic != elf::ELFMAG || header.e_ident.class != elf::ELFCLASS64 {
            return None;
        }
        let (table, count) = (header.e_shoff.get(LE) as usize, header.e_shnum.get(LE) as usize);
        let names = usize::from(header.e_shstrndx.get(LE));
        let place = |index: usize| table + index * size_of::<SectionHeader64<LE>>();
        let section = |object: &[u8], index: usize| {
            let (section, _) =
                from_bytes::<SectionHeader64<LE>>(object.get(place(index)..)?).ok()?;
            Some(*section)
        };
        // The names once more at the end, with one that is new.
        let mut strings = section(&object, names)?;
        let start = strings.sh_offset.get(LE) as usize;
        let size = strings.sh_size.get(LE) as usize;
        let mut all_names = object.get(start..start.checked_add(size)?)?.to_vec();
        let new_name = all_names.len() as u32;
        all_names.extend_from_slice(self.name.as_bytes());
        all_names.push(0);
        let mut changed = Vec::new();
        for index in 0..count {
            let mut header = section(&object, index)?;
            let name = all_names.get(header.sh_name.get(LE) as usize..)?;
            let name = name.split(|byte| *byte == 0).next()?;
            let flags = header.sh_flags.get(LE) as u32;
            let is_variable = [elf::SHT_PROGBITS, elf::SHT_NOBITS].contains(&header.sh_type.get(LE))
                && flags & elf::SHF_ALLOC != 0
                && flags & elf::SHF_WRITE != 0
                // Constants with addresses, which are written when the library is loaded.
                && !name.starts_with(b".data.rel.ro")
                && ![&b".ctors"[..], b".dtors", b".tm_clone_table"].contains(&name);
            if !is_variable {
                continue;
            }
            header.sh_name.set(LE, new_name);
            if header.sh_type.get(LE) == elf::SHT_NOBITS {
                header.sh_type.set(LE, elf::SHT_PROGBITS);
                let align = header.sh_addralign.get(LE).max(1) as usize;
                object.resize(object.len().next_multiple_of(align), 0);
                header.sh_offset.set(LE, object.len() as u64);
                object.resize(object.len() + header.sh_size.get(LE) as usize, 0);
            }
            changed.push((index, header));
        }
        if changed.is_empty() {
            return Some(object);
        }
        strings.sh_offset.set(LE, object.len() as u64);
        strings.sh_size.set(LE, all_names.len() as u64);
        object.extend(all_names);
        for (index, header) in changed.into_iter().chain([(names, strings)]) {
            *from_bytes_mut::<SectionHeader64<LE>>(object.get_mut(place(index)..)?).ok()?.0 =
                header;
        }
        Some(object)
    }

    fn moved_in_coff(&self, mut object: Vec<u8>) -> Option<Vec<u8>> {
        let (header, _) = from_bytes::<ImageFileHeader>(&object).ok()?;
        if header.machine.get(LE) != pe::IMAGE_FILE_MACHINE_AMD64 {
            return None;
        }
        let count = usize::from(header.number_of_sections.get(LE));
        let symbols = header.number_of_symbols.get(LE) as usize * pe::IMAGE_SIZEOF_SYMBOL;
        let strings = header.pointer_to_symbol_table.get(LE) as usize + symbols;
        let table =
            size_of::<ImageFileHeader>() + usize::from(header.size_of_optional_header.get(LE));
        for index in 0..count {
            let place = table + index * size_of::<ImageSectionHeader>();
            let (section, _) = from_bytes::<ImageSectionHeader>(object.get(place..)?).ok()?;
            let mut section = *section;
            let flags = section.characteristics.get(LE);
            // A name of more than 8 characters is `/` and its place in the table of strings.
            let place_of_name = std::str::from_utf8(&section.name).ok().and_then(|name| {
                name.strip_prefix('/')?.trim_end_matches('\0').parse::<usize>().ok()
            });
            let name = match place_of_name {
                Some(place) => object.get(strings + place..)?,
                None => &section.name,
            };
            let is_variable = flags & pe::IMAGE_SCN_MEM_WRITE != 0
                && [&b".data"[..], b".bss"].iter().any(|start| name.starts_with(start));
            if !is_variable {
                continue;
            }
            section.name = *<&[u8; 8]>::try_from(format!("{}$m", self.name).as_bytes()).ok()?;
            if flags & pe::IMAGE_SCN_CNT_UNINITIALIZED_DATA != 0 {
                let is_empty = section.size_of_raw_data.get(LE) == 0;
                let start = if is_empty { 0 } else { object.len().next_multiple_of(16) };
                section.pointer_to_raw_data.set(LE, start as u32);
                let size = section.size_of_raw_data.get(LE) as usize;
                object.resize(object.len().max(start + size), 0);
                let kind =
                    pe::IMAGE_SCN_CNT_UNINITIALIZED_DATA | pe::IMAGE_SCN_CNT_INITIALIZED_DATA;
                section.characteristics.set(LE, flags ^ kind);
            }
            *from_bytes_mut::<ImageSectionHeader>(object.get_mut(place..)?).ok()?.0 = section;
        }
        Some(object)
    }
}
