use crate::path::Drawing;
use crate::summary::Summary;
pub fn format_of(_: &std::path::Path) -> anyhow::Result<()> { Ok(()) }
pub fn write(_: &std::path::Path, _: &Drawing, _: &Summary) -> anyhow::Result<()> { Ok(()) }
