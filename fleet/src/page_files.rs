//! The files of the operator's page, embedded in the program: no file and no network is needed to serve them.

use bridge::PageFile;

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const IMAGE: &str = "image/svg+xml";

/// Embeds a file of `page/`; its path in the URL is its name.
macro_rules! file {
    ($name:literal, $content_type:ident) => {
        file!(concat!("/", $name), $name, $content_type)
    };
    ($path:expr, $name:literal, $content_type:ident) => {
        PageFile {
            path: $path,
            content_type: $content_type,
            bytes: include_bytes!(concat!("../../page/", $name)),
        }
    };
}

/// All files of the page.
pub const PAGE_FILES: &[PageFile] = &[
    file!("/", "index.html", HTML),
    file!("style.css", STYLE),
    file!("icon.svg", IMAGE),
    file!("main.js", SCRIPT),
    file!("attention.js", SCRIPT),
    file!("battery.js", SCRIPT),
    file!("cdr.js", SCRIPT),
    file!("clock.js", SCRIPT),
    file!("controls.js", SCRIPT),
    file!("coordinates.js", SCRIPT),
    file!("dead_man.js", SCRIPT),
    file!("driving.js", SCRIPT),
    file!("edges.js", SCRIPT),
    file!("exploration.js", SCRIPT),
    file!("format.js", SCRIPT),
    file!("geometry.js", SCRIPT),
    file!("goals.js", SCRIPT),
    file!("hint.js", SCRIPT),
    file!("input.js", SCRIPT),
    file!("isolation.js", SCRIPT),
    file!("keys.js", SCRIPT),
    file!("layers.js", SCRIPT),
    file!("map_cursor.js", SCRIPT),
    file!("map_tools.js", SCRIPT),
    file!("map_view.js", SCRIPT),
    file!("matrix.js", SCRIPT),
    file!("measure.js", SCRIPT),
    file!("merged_map.js", SCRIPT),
    file!("messages.js", SCRIPT),
    file!("models.js", SCRIPT),
    file!("panels.js", SCRIPT),
    file!("pointers.js", SCRIPT),
    file!("polygon.js", SCRIPT),
    file!("pose_tool.js", SCRIPT),
    file!("renderer.js", SCRIPT),
    file!("seen.js", SCRIPT),
    file!("/selfcheck", "selfcheck.html", HTML),
    file!("selfcheck.js", SCRIPT),
    file!("shaders.js", SCRIPT),
    file!("state.js", SCRIPT),
    file!("stop.js", SCRIPT),
    file!("stop_buttons.js", SCRIPT),
    file!("/tlx", "tlx.html", HTML),
    file!("tlx.js", SCRIPT),
    file!("transport.js", SCRIPT),
    file!("view.js", SCRIPT),
    file!("xr.js", SCRIPT),
    file!("xr_alignment.js", SCRIPT),
    file!("xr_anchors.js", SCRIPT),
    file!("xr_commands.js", SCRIPT),
    file!("xr_haptics.js", SCRIPT),
    file!("xr_hands.js", SCRIPT),
    file!("xr_input.js", SCRIPT),
    file!("xr_marks.js", SCRIPT),
    file!("xr_panels.js", SCRIPT),
    file!("xr_pointing.js", SCRIPT),
    file!("xr_room.js", SCRIPT),
    file!("xr_scene.js", SCRIPT),
    file!("xr_session.js", SCRIPT),
    file!("xr_views.js", SCRIPT),
    file!("zones.js", SCRIPT),
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Paths of the files that a file of the page refers to.
    fn references(file: &PageFile) -> Vec<String> {
        let text = std::str::from_utf8(file.bytes).unwrap();
        let quoted = text.split('"').skip(1).step_by(2);
        let of_imports =
            quoted.filter_map(|quoted| quoted.strip_prefix("./")).filter(|name| !name.is_empty());
        let is_linked =
            |name: &&str| ["main.js", "selfcheck.js", "tlx.js", "style.css", "icon.svg"].contains(name);
        let linked = text.split('"').filter(is_linked).filter(|_| file.content_type == HTML);
        of_imports.chain(linked).map(|name| format!("/{name}")).collect()
    }

    #[test]
    fn every_file_that_the_page_refers_to_is_embedded() {
        for file in PAGE_FILES.iter().filter(|file| [HTML, SCRIPT].contains(&file.content_type)) {
            for path in references(file) {
                assert!(PAGE_FILES.iter().any(|known| known.path == path), "{} needs {path}", file.path);
            }
        }
        assert!(references(&PAGE_FILES[0]).len() >= 3);
    }

    #[test]
    fn the_page_needs_nothing_from_elsewhere() {
        for file in PAGE_FILES {
            let text = std::str::from_utf8(file.bytes).unwrap();
            let outside = text.replace("http://www.w3.org/2000/svg", "");
            assert!(!outside.contains("http://") && !outside.contains("https://"), "{}", file.path);
        }
    }

    #[test]
    fn the_page_is_small() {
        /// Bytes of the whole page, each file compressed as a server would.
        const COMPRESSED_BYTES_MAX: usize = 120 << 10;
        let compressed = |file: &PageFile| {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
            std::io::Write::write_all(&mut encoder, file.bytes).unwrap();
            encoder.finish().unwrap().len()
        };
        assert!(PAGE_FILES.iter().map(compressed).sum::<usize>() < COMPRESSED_BYTES_MAX);
    }
}
