//! Pages of Parquet that are compressed by zstd, for which the crate `parquet` would need a library in C.

use std::fs::File;
use std::io::Read;
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::bloom_filter::Sbbf;
use parquet::column::page::{Page, PageMetadata, PageReader};
use parquet::errors::{ParquetError, Result};
use parquet::file::metadata::RowGroupMetaData;
use parquet::file::reader::RowGroupReader;
use parquet::file::serialized_reader::SerializedPageReader;
use parquet::record::reader::RowIter;
use parquet::schema::types::Type;
use ruzstd::decoding::StreamingDecoder;

/// A row group whose columns may be compressed by zstd.
pub(super) struct Group<'a> {
    file: Arc<File>,
    group: Box<dyn RowGroupReader + 'a>,
}

impl<'a> Group<'a> {
    /// A row group of a file.
    pub(super) fn new(file: Arc<File>, group: Box<dyn RowGroupReader + 'a>) -> Self {
        Self { file, group }
    }
}

impl RowGroupReader for Group<'_> {
    fn metadata(&self) -> &RowGroupMetaData {
        self.group.metadata()
    }

    fn num_columns(&self) -> usize {
        self.group.num_columns()
    }

    fn get_column_page_reader(&self, column: usize) -> Result<Box<dyn PageReader>> {
        let chunk = self.metadata().column(column);
        if !matches!(chunk.compression(), Compression::ZSTD(_)) {
            return self.group.get_column_page_reader(column);
        }
        let limit = chunk.uncompressed_size().try_into()?;
        // Its pages as they are.
        let chunk = chunk.clone().into_builder().set_compression(Compression::UNCOMPRESSED);
        let rows = self.metadata().num_rows().try_into()?;
        let pages = SerializedPageReader::new(self.file.clone(), &chunk.build()?, rows, None)?;
        Ok(Box::new(Pages { pages, limit }))
    }

    fn get_column_bloom_filter(&self, column: usize) -> Option<&Sbbf> {
        self.group.get_column_bloom_filter(column)
    }

    fn get_row_iter(&self, projection: Option<Type>) -> Result<RowIter<'_>> {
        RowIter::from_row_group(projection, self)
    }
}

/// The pages of a column.
struct Pages {
    pages: SerializedPageReader<File>,
    /// The length of all of them without compression (bytes).
    limit: u64,
}

impl Pages {
    /// The bytes of a page, of which this many at the beginning are not compressed.
    fn decompressed(&self, page: &[u8], plain: usize) -> Result<Vec<u8>> {
        let wrong = |what: String| ParquetError::General(format!("zstd: {what}"));
        let (plain, compressed) = page
            .split_at_checked(plain)
            .ok_or_else(|| wrong("a page is shorter than its levels".into()))?;
        let mut bytes = plain.to_vec();
        // A page without values may be empty.
        if !compressed.is_empty() {
            let decoder = StreamingDecoder::new(compressed).map_err(|e| wrong(e.to_string()))?;
            let read = decoder.take(self.limit).read_to_end(&mut bytes);
            read.map_err(|error| wrong(error.to_string()))?;
        }
        Ok(bytes)
    }
}

impl PageReader for Pages {
    fn get_next_page(&mut self) -> Result<Option<Page>> {
        let Some(mut page) = self.pages.get_next_page()? else { return Ok(None) };
        let (bytes, plain) = match &page {
            Page::DataPageV2 { is_compressed: false, .. } => return Ok(Some(page)),
            Page::DataPageV2 { buf, def_levels_byte_len, rep_levels_byte_len, .. } => {
                let levels = u64::from(*def_levels_byte_len) + u64::from(*rep_levels_byte_len);
                (buf, levels.try_into()?)
            }
            Page::DataPage { buf, .. } | Page::DictionaryPage { buf, .. } => (buf, 0),
        };
        let bytes = self.decompressed(bytes, plain)?;
        match &mut page {
            Page::DataPage { buf, .. }
            | Page::DataPageV2 { buf, .. }
            | Page::DictionaryPage { buf, .. } => *buf = bytes.into(),
        }
        Ok(Some(page))
    }

    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>> {
        self.pages.peek_next_page()
    }

    fn skip_next_page(&mut self) -> Result<()> {
        self.pages.skip_next_page()
    }
}

impl Iterator for Pages {
    type Item = Result<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}
