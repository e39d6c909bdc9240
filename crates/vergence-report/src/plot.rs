use std::fmt::Write as _;

use crate::{
    Axis, Error,
    axis::Layout,
    labels::{Placer, Rect},
    text::{escaped, number, width_px},
};

/// Eight colours that people with any colour vision can tell apart (Okabe & Ito 2008), black last because axes use
/// it.
pub const OKABE_ITO: [&str; 8] =
    ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000"];

/// Least size that leaves room beside the axes, pixels.
const LEAST_SIZE: (u32, u32) = (240, 180);
const FONT_PX: f64 = 12.0;
const TITLE_PX: f64 = 16.0;
/// From a line of the title to the next.
const TITLE_LINE_PX: f64 = 18.0;
/// Room for the labels of the y axis.
const LEFT_PX: f64 = 74.0;
const LABEL_PX: f64 = 10.5;
/// Half the side of a marker, pixels.
const MARKER_PX: f64 = 4.0;

/// Points and lines over two axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    title: String,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
    width: u32,
    height: u32,
}

/// Points that belong together: one colour, one shape, one line in the legend.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    name: String,
    style: Style,
    points: Vec<Point>,
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Markers.
    Points,
    /// Pale markers with an edge: what others are compared with.
    FaintPoints,
    /// Large rings around points of other series.
    Rings,
    /// Markers joined by straight lines, in the order given.
    Line,
    /// A black line without markers: a law, drawn over what it was fitted to.
    Curve,
    /// Markers joined by steps (first along x, then along y): a front, of which nothing lies between two points.
    Steps,
}

/// A place in a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    x: f64,
    y: f64,
    label: Option<String>,
    tooltip: Option<String>,
}

impl Point {
    /// At (`x`, `y`), in the units of the axes. What has no place on the axes (not finite; not positive where they
    /// are logarithmic) is left out of the picture and counted below it.
    pub fn new(x: f64, y: f64) -> Self {
        Self { x, y, label: None, tooltip: None }
    }

    /// With a text beside it, where there is room.
    pub fn labelled(mut self, label: impl Into<String>) -> Self {
        self.label = Some(label.into());
        self
    }

    /// With a text that shows when one points at it.
    pub fn with_tooltip(mut self, tooltip: impl Into<String>) -> Self {
        self.tooltip = Some(tooltip.into());
        self
    }
}

impl Series {
    /// `name` stands in the legend.
    pub fn new(name: impl Into<String>, style: Style, points: Vec<Point>) -> Self {
        Self { name: name.into(), style, points }
    }
}

impl Plot {
    /// An empty plot of 760 × 480 pixels.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self { title: title.into(), x, y, series: Vec::new(), width: 760, height: 480 }
    }

    /// With one more series; later ones are drawn over earlier ones.
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Of another size, in pixels (SVG scales; this sets how large the text is beside the picture).
    pub fn with_size(mut self, width: u32, height: u32) -> Self {
        (self.width, self.height) = (width, height);
        self
    }

    /// The same as wide as a phone, on which a pixel of ours is about one of its, and as high as title and legend then need.
    pub(crate) fn narrow(&self) -> Self {
        let mut plot = self.clone().with_size(360, 0);
        let lines = plot.title_lines().len() as f64 * TITLE_LINE_PX + plot.legend_rows().len() as f64 * 18.0;
        plot.height = 330 + lines as u32;
        plot
    }

    /// The plot as an SVG document. O(points + labels²).
    ///
    /// # Errors
    /// Where a given axis range is none, or the size leaves no room.
    pub fn to_svg(&self) -> Result<String, Error> {
        let found = (self.width, self.height);
        if self.width < LEAST_SIZE.0 || self.height < LEAST_SIZE.1 {
            return Err(Error::Size { expected: LEAST_SIZE, found });
        }
        let legend = self.legend_rows();
        let title = self.title_lines();
        let top = 20.0 + title.len() as f64 * TITLE_LINE_PX + legend.len() as f64 * 18.0;
        let left = LEFT_PX;
        let frame = Rect {
            x: left,
            y: top,
            width: f64::from(self.width) - left - 24.0,
            height: f64::from(self.height) - top - 58.0,
        };
        if frame.height < 60.0 {
            let expected = (self.width, self.height + 60);
            return Err(Error::Size { expected, found });
        }
        let points = || self.series.iter().flat_map(|s| &s.points).filter(|p| self.has_place(p));
        let x = self.x.laid_out(points().map(|p| p.x), frame.width)?;
        let y = self.y.laid_out(points().map(|p| p.y), frame.height)?;
        let canvas = Canvas { frame, x, y };
        let mut svg = String::new();
        self.draw_frame(&mut svg, &canvas, &title);
        self.draw_legend(&mut svg, &legend, title.len());
        let _ = writeln!(svg, "<g clip-path=\"url(#frame)\">");
        for (index, series) in self.series.iter().enumerate() {
            self.draw_series(&mut svg, &canvas, index, series);
        }
        let _ = writeln!(svg, "</g>");
        self.draw_labels(&mut svg, &canvas);
        self.draw_note(&mut svg, &canvas);
        let _ = writeln!(svg, "</svg>");
        Ok(svg)
    }

    fn has_place(&self, point: &Point) -> bool {
        self.x.accepts(point.x) && self.y.accepts(point.y)
    }

    /// The title, in as many lines as it takes.
    fn title_lines(&self) -> Vec<String> {
        // Bold letters are wider.
        let room = (f64::from(self.width) - LEFT_PX - 8.0) / 1.15;
        let mut lines = vec![String::new()];
        for word in self.title.split_whitespace() {
            let last = lines.last().cloned().unwrap_or_default();
            let joined = if last.is_empty() { word.to_owned() } else { format!("{last} {word}") };
            if last.is_empty() || width_px(&joined, TITLE_PX) <= room {
                lines.pop();
                lines.push(joined);
            } else {
                lines.push(word.to_owned());
            }
        }
        lines
    }

    fn draw_frame(&self, svg: &mut String, canvas: &Canvas, title_lines: &[String]) {
        let (width, height) = (self.width, self.height);
        let Rect { x: left, y: top, width: w, height: h } = canvas.frame;
        let (right, bottom) = (left + w, top + h);
        let title = escaped(&self.title);
        let _ = writeln!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
             height=\"{height}\" role=\"img\" font-family=\"system-ui, 'DejaVu Sans', Arial, sans-serif\" \
             font-size=\"{FONT_PX}\"><title>{title}</title>\n\
             <clipPath id=\"frame\"><rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\"/></clipPath>\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>",
            left - 2.0 * MARKER_PX,
            top - 2.0 * MARKER_PX,
            w + 4.0 * MARKER_PX,
            h + 4.0 * MARKER_PX,
        );
        for (i, line) in title_lines.iter().enumerate() {
            let _ = writeln!(
                svg,
                "<text x=\"{left:.1}\" y=\"{:.1}\" font-size=\"{TITLE_PX}\" font-weight=\"600\">{}</text>",
                8.0 + TITLE_PX + TITLE_LINE_PX * i as f64,
                escaped(line)
            );
        }
        for (value, label) in &canvas.x.ticks {
            let x = left + canvas.x.position(*value);
            let _ = writeln!(
                svg,
                "<path d=\"M{x:.1} {top:.1}V{bottom:.1}\" stroke=\"#e3e3e3\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                bottom + 16.0
            );
        }
        for (value, label) in &canvas.y.ticks {
            let y = bottom - canvas.y.position(*value);
            let _ = writeln!(
                svg,
                "<path d=\"M{left:.1} {y:.1}H{right:.1}\" stroke=\"#e3e3e3\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                left - 6.0,
                y + 4.0
            );
        }
        let _ = writeln!(
            svg,
            "<path d=\"M{left:.1} {top:.1}V{bottom:.1}H{right:.1}\" fill=\"none\" stroke=\"#333\"/>\n\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\n\
             <text transform=\"translate(18 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            left + 0.5 * w,
            bottom + 36.0,
            escaped(&self.x.label),
            top + 0.5 * h,
            escaped(&self.y.label)
        );
    }

    /// Which series stand in which line of the legend, with their places.
    fn legend_rows(&self) -> Vec<Vec<(usize, f64)>> {
        let mut rows: Vec<Vec<(usize, f64)>> = Vec::new();
        let mut x = f64::INFINITY;
        for (index, series) in self.series.iter().enumerate().filter(|(_, s)| !s.name.is_empty()) {
            let width = 34.0 + width_px(&series.name, FONT_PX);
            if x + width > f64::from(self.width) - 24.0 {
                rows.push(Vec::new());
                x = LEFT_PX;
            }
            if let Some(row) = rows.last_mut() {
                row.push((index, x));
            }
            x += width;
        }
        rows
    }

    fn draw_legend(&self, svg: &mut String, rows: &[Vec<(usize, f64)>], title_lines: usize) {
        for (row, entries) in rows.iter().enumerate() {
            let y = 24.0 + TITLE_LINE_PX * title_lines as f64 + 18.0 * row as f64;
            for &(index, x) in entries {
                let series = &self.series[index];
                if matches!(series.style, Style::Line | Style::Curve | Style::Steps) {
                    let color = color_of(index, series.style);
                    let _ =
                        write!(svg, "<path d=\"M{x:.1} {y:.1}h18\" stroke=\"{color}\" stroke-width=\"2\"/>");
                }
                let marker = |index, style, x, y| match style {
                    Style::Curve => String::new(),
                    style => marker(index, style, x, y, ""),
                };
                let _ = writeln!(
                    svg,
                    "{}<text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                    marker(index, series.style, x + 9.0, y),
                    x + 23.0,
                    y + 4.0,
                    escaped(&series.name)
                );
            }
        }
    }

    fn draw_series(&self, svg: &mut String, canvas: &Canvas, index: usize, series: &Series) {
        let shown: Vec<&Point> = series.points.iter().filter(|p| self.has_place(p)).collect();
        if matches!(series.style, Style::Line | Style::Curve | Style::Steps) && shown.len() > 1 {
            let mut path = String::new();
            for (i, point) in shown.iter().enumerate() {
                let (x, y) = canvas.place(point);
                let _ = match (i, series.style) {
                    (0, _) => write!(path, "M{x:.1} {y:.1}"),
                    (_, Style::Steps) => write!(path, "H{x:.1}V{y:.1}"),
                    _ => write!(path, "L{x:.1} {y:.1}"),
                };
            }
            let color = color_of(index, series.style);
            let _ = writeln!(
                svg,
                "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\" stroke-linejoin=\"round\"/>"
            );
        }
        for point in shown.into_iter().filter(|_| series.style != Style::Curve) {
            let (x, y) = canvas.place(point);
            let tooltip = match (&point.tooltip, &point.label) {
                (Some(text), _) | (None, Some(text)) => escaped(text),
                (None, None) => format!("{}, {}", number(point.x, 4), number(point.y, 4)),
            };
            let _ = writeln!(svg, "{}", marker(index, series.style, x, y, &tooltip));
        }
    }

    fn draw_labels(&self, svg: &mut String, canvas: &Canvas) {
        let shown = |s: &'_ Series| -> Vec<Point> {
            s.points.iter().filter(|p| self.has_place(p) && canvas.contains(p)).cloned().collect()
        };
        let box_around = |p: &Point| {
            let (x, y) = canvas.place(p);
            let side = 2.0 * MARKER_PX;
            Rect { x: x - MARKER_PX, y: y - MARKER_PX, width: side, height: side }
        };
        let markers = self.series.iter().flat_map(shown).map(|p| box_around(&p)).collect();
        let mut placer = Placer::new(canvas.frame, markers);
        // The last series lies on top: its labels choose first.
        for series in self.series.iter().rev() {
            for point in shown(series) {
                let Some(label) = &point.label else { continue };
                let (x, y) = canvas.place(&point);
                let size = (width_px(label, LABEL_PX), LABEL_PX + 2.0);
                if let Some(place) = placer.place(x, y, size.0, size.1) {
                    let _ = writeln!(
                        svg,
                        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"{LABEL_PX}\" \
                         fill=\"#222\" stroke=\"#fff\" stroke-width=\"2\" paint-order=\"stroke\">{}</text>",
                        place.x + 0.5 * size.0,
                        place.y + LABEL_PX - 0.5,
                        escaped(label)
                    );
                }
            }
        }
    }

    fn draw_note(&self, svg: &mut String, canvas: &Canvas) {
        let all: usize = self.series.iter().map(|s| s.points.len()).sum();
        let drawn = self.series.iter().flat_map(|s| &s.points);
        let missing = all - drawn.filter(|p| self.has_place(p) && canvas.contains(p)).count();
        if missing > 0 {
            let _ = writeln!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"{LABEL_PX}\" fill=\"#555\">{missing} of {all} points have \
                 no place on these axes</text>",
                canvas.frame.x,
                f64::from(self.height) - 6.0
            );
        }
    }
}

struct Canvas {
    frame: Rect,
    x: Layout,
    y: Layout,
}

impl Canvas {
    fn place(&self, point: &Point) -> (f64, f64) {
        let bottom = self.frame.y + self.frame.height;
        (self.frame.x + self.x.position(point.x), bottom - self.y.position(point.y))
    }

    fn contains(&self, point: &Point) -> bool {
        self.x.contains(point.x) && self.y.contains(point.y)
    }
}

/// A series' colour; a law is black.
fn color_of(index: usize, style: Style) -> &'static str {
    if style == Style::Curve { OKABE_ITO[7] } else { OKABE_ITO[index % OKABE_ITO.len()] }
}

/// Circle, square, triangle, diamond, cross…: the shape says the series, too, not only the colour.
fn marker(index: usize, style: Style, x: f64, y: f64, tooltip: &str) -> String {
    let r = MARKER_PX;
    let shape = match index % 5 {
        _ if style == Style::Rings => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\"", 2.0 * r),
        0 => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r}\""),
        1 => format!("<path d=\"M{:.1} {:.1}h{}v{}h-{}z\"", x - r, y - r, 2.0 * r, 2.0 * r, 2.0 * r),
        2 => format!("<path d=\"M{x:.1} {:.1}l{r} {}h-{}z\"", y - r, 2.0 * r, 2.0 * r),
        3 => format!("<path d=\"M{x:.1} {:.1}l{r} {r}l-{r} {r}l-{r} -{r}z\"", y - r),
        _ => format!("<path d=\"M{:.1} {:.1}l{r} {}h-{}z\"", x - r, y - r, 2.0 * r, 2.0 * r),
    };
    let color = OKABE_ITO[index % OKABE_ITO.len()];
    let paint = match style {
        Style::FaintPoints => {
            format!("fill=\"{color}\" fill-opacity=\"0.3\" stroke=\"{color}\" stroke-width=\"1.2\"")
        }
        Style::Rings => format!("fill=\"none\" stroke=\"{color}\" stroke-width=\"2.5\""),
        _ => format!("fill=\"{color}\" stroke=\"#fff\" stroke-width=\"0.8\""),
    };
    let element = if shape.starts_with("<circle") { "circle" } else { "path" };
    if tooltip.is_empty() {
        format!("{shape} {paint}/>")
    } else {
        format!("{shape} {paint}><title>{tooltip}</title></{element}>")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot() -> Plot {
        let cloud = (0..30).map(|i| Point::new(f64::from(i % 7) + 1.0, f64::from(i * i % 11))).collect();
        let front =
            vec![Point::new(1.0, 9.0).labelled("<first>"), Point::new(5.0, 2.0).with_tooltip("a & b")];
        Plot::new("Cost & error", Axis::log("cost (ms)"), Axis::linear("error"))
            .with(Series::new("all", Style::FaintPoints, cloud))
            .with(Series::new("front", Style::Steps, front))
    }

    #[test]
    fn the_same_data_gives_the_same_bytes_and_text_is_escaped() {
        let svg = plot().to_svg().unwrap();
        assert_eq!(svg, plot().to_svg().unwrap());
        assert!(
            svg.contains("&lt;first&gt;") && svg.contains("a &amp; b") && svg.contains("Cost &amp; error")
        );
        assert!(!svg.contains("<first>") && !svg.contains("NaN") && !svg.contains("no place"));
        for element in ["text", "g", "svg", "circle", "title"] {
            let (opened, closed) = (format!("<{element}"), format!("</{element}>"));
            let opened = svg.matches(&opened).count();
            let self_closed = svg.matches("<circle").count() - svg.matches("</circle>").count();
            let expected = svg.matches(&closed).count() + if element == "circle" { self_closed } else { 0 };
            assert_eq!(opened, expected, "{element}");
        }
    }

    #[test]
    fn a_long_title_is_broken_where_there_is_no_room() {
        let wide =
            Plot::new("Conditional accuracy: misses by movement time", Axis::linear("x"), Axis::linear("y"));
        let narrow = wide.clone().with_size(360, 360);
        assert_eq!((wide.title_lines().len(), narrow.title_lines().len()), (1, 2));
        assert_eq!(narrow.title_lines().join(" "), "Conditional accuracy: misses by movement time");
        let none = Plot::new("", Axis::linear("x"), Axis::linear("y")).with_size(360, 360);
        assert!(none.to_svg().is_ok());
    }

    #[test]
    fn what_has_no_place_is_counted() {
        let points = vec![
            Point::new(1.0, 1.0),
            Point::new(0.0, 1.0),
            Point::new(f64::NAN, 1.0),
            Point::new(2.0, f64::INFINITY),
            Point::new(9.0, 1.0),
        ];
        let plot = Plot::new("", Axis::log("x").with_range(0.5, 5.0), Axis::linear("y")).with(Series::new(
            "s",
            Style::Line,
            points,
        ));
        let svg = plot.to_svg().unwrap();
        assert!(svg.contains("4 of 5 points have no place") && !svg.contains("inf") && !svg.contains("NaN"));
        assert!(plot.with_size(100, 100).to_svg().is_err());
    }
}
