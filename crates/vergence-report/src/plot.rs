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
    is_map: bool,
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
    /// A line without markers in the series' colour: so many points that each is none by itself.
    Path,
    /// Markers joined by steps (first along x, then along y): a front, of which nothing lies between two points.
    Steps,
}

impl Style {
    fn is_line(self) -> bool {
        matches!(self, Self::Line | Self::Curve | Self::Path | Self::Steps)
    }

    /// Without markers.
    fn is_bare(self) -> bool {
        matches!(self, Self::Curve | Self::Path)
    }
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
        Self { title: title.into(), x, y, series: Vec::new(), width: 760, height: 480, is_map: false }
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

    /// A map: a unit is as long along one axis as along the other, and both axes reach as far as the points do, whatever range they were given.
    pub fn as_map(mut self) -> Self {
        self.is_map = true;
        self
    }

    /// Several plots in one SVG document, one below the other.
    ///
    /// # Errors
    /// Those of [`Plot::to_svg`].
    pub fn stacked(plots: &[Self]) -> Result<String, Error> {
        let width = plots.iter().map(|plot| plot.width).max().unwrap_or(0);
        let height: u32 = plots.iter().map(|plot| plot.height).sum();
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\">\n"
        );
        let mut top = 0;
        for plot in plots {
            let inner = plot.to_svg()?;
            // Names are those of the whole document.
            let (id, place) = (format!("frame{top}"), format!("<svg y=\"{top}\" "));
            svg += &inner
                .replacen("<svg ", &place, 1)
                .replace("id=\"frame\"", &format!("id=\"{id}\""))
                .replace("url(#frame)", &format!("url(#{id})"));
            top += plot.height;
        }
        svg += "</svg>\n";
        Ok(svg)
    }

    /// The axes, laid out along so many pixels.
    fn axes(&self, points: &[&Point], width: f64, height: f64) -> Result<(Layout, Layout), Error> {
        let (xs, ys) = (points.iter().map(|p| p.x), points.iter().map(|p| p.y));
        if !self.is_map || points.is_empty() {
            return Ok((self.x.laid_out(xs, width)?, self.y.laid_out(ys, height)?));
        }
        let ends = |values: &mut dyn Iterator<Item = f64>| {
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
        };
        let (x, y) = (ends(&mut { xs }), ends(&mut { ys }));
        // A twentieth of air on each side; one unit where everything is at one place.
        let unit = ((x.1 - x.0) / width).max((y.1 - y.0) / height) * 1.1;
        let least = 1e-9 * [x.0, x.1, y.0, y.1].into_iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let unit = if unit * width > least { unit } else { 1.0 / width };
        let around = |axis: &Axis, (low, high): (f64, f64), length: f64| {
            let (middle, half) = (0.5 * low + 0.5 * high, 0.5 * unit * length);
            axis.clone().with_range(middle - half, middle + half).laid_out(std::iter::empty(), length)
        };
        Ok((around(&self.x, x, width)?, around(&self.y, y, height)?))
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
        let points: Vec<&Point> =
            self.series.iter().flat_map(|s| &s.points).filter(|p| self.has_place(p)).collect();
        let (x, y) = self.axes(&points, frame.width, frame.height)?;
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
                if series.style.is_line() {
                    let color = color_of(index, series.style);
                    let _ =
                        write!(svg, "<path d=\"M{x:.1} {y:.1}h18\" stroke=\"{color}\" stroke-width=\"2\"/>");
                }
                let marker = |index, style, x, y| match style {
                    Style::Curve | Style::Path => String::new(),
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
        if series.style.is_line() && shown.len() > 1 {
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
        for point in shown.into_iter().filter(|_| !series.style.is_bare()) {
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
    fn a_map_has_one_scale_and_reaches_as_far_as_its_points() {
        let circle = |x: f64, y: f64| {
            let at = |i: i32| (f64::from(i) * 0.1).sin_cos();
            (0..63).map(|i| Point::new(x + at(i).0, y + 0.2 * at(i).1)).collect::<Vec<_>>()
        };
        for (x, y) in [(0.0, 0.0), (100.0, -40.0)] {
            let map = Plot::new("", Axis::linear("x (m)"), Axis::linear("y (m)"))
                .with(Series::new("way", Style::Path, circle(x, y)))
                .as_map();
            let points: Vec<&Point> = map.series[0].points.iter().collect();
            let (along, up) = map.axes(&points, 600.0, 300.0).unwrap();
            let px = |layout: &Layout, from: f64| layout.position(from + 1.0) - layout.position(from);
            assert!((px(&along, x) / px(&up, y) - 1.0).abs() < 1e-9);
            // The wider side fills the plot but for its air, the middle is in the middle.
            assert!((2.0 * px(&along, x) - 600.0 / 1.1).abs() < 2.0, "{}", px(&along, x));
            assert!((along.position(x) - 300.0).abs() < 2.0 && (up.position(y) - 150.0).abs() < 2.0);
            assert!(map.to_svg().unwrap().contains("stroke=\"#0072B2\""));
        }
        // All at one place, and nothing at all.
        for points in [vec![Point::new(3.0, 3.0); 4], Vec::new()] {
            let map = Plot::new("", Axis::linear("x"), Axis::linear("y"));
            assert!(map.with(Series::new("", Style::Path, points)).as_map().to_svg().is_ok());
        }
    }

    #[test]
    fn plots_below_each_other_are_one_document_with_names_of_their_own() {
        let both = Plot::stacked(&[plot(), plot().with_size(500, 300)]).unwrap();
        assert!(both.contains("viewBox=\"0 0 760 780\"") && both.contains("<svg y=\"480\""), "{both}");
        assert_eq!(both.matches("url(#frame0)").count(), 1);
        assert_eq!(both.matches("url(#frame480)").count(), 1);
        assert!(!both.contains("url(#frame)"));
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
