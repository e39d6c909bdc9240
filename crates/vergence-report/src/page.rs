use base64::Engine as _;

use crate::{Error, Plot, Table, text::escaped};

/// An HTML page in one file: style, script and pictures inside, nothing is loaded from anywhere (its own security
/// policy forbids it).
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    title: String,
    body: String,
}

const STYLE: &str = "
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, 'DejaVu Sans', Arial, sans-serif; max-width: 70rem; margin: 0 auto; padding: 1rem; }
p { max-width: 60rem; }
h1 { font-size: 1.5rem; line-height: 1.2; } h2 { font-size: 1.2rem; margin-top: 2rem; }
figure { margin: 1rem 0; overflow-x: auto; } figure svg, figure img { max-width: 100%; height: auto; background: #fff; }
.narrow { display: none; }
tfoot td { border-top: 2px solid #888; }
.wide td:first-child, .wide th:first-child { position: sticky; left: 0; background: Canvas; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.9rem; }
th, td { padding: 0.25rem 0.6rem; border-bottom: 1px solid #8884; text-align: left; white-space: nowrap; }
td[data-value] { text-align: right; }
th { position: sticky; top: 0; } th button { font: inherit; font-weight: 600; border: 0; padding: 0.4rem 0; background: none;
  color: inherit; cursor: pointer; } th button::after { content: ' ↕'; opacity: 0.4; }
th[aria-sort=ascending] button::after { content: ' ↑'; opacity: 1; }
th[aria-sort=descending] button::after { content: ' ↓'; opacity: 1; }
@media (max-width: 40rem) {
  figure.roomy { display: none; } figure.narrow { display: block; } figure.narrow svg { width: 100%; }
  .wide::before { content: 'more to the right →'; display: block; position: sticky; left: 0; font-size: 0.8rem; opacity: 0.7; }
}
@media print { figure.roomy { display: block; } figure.narrow { display: none; } }
tr.marked { background: #0072b222; font-weight: 600; }
.wide tr.marked td:first-child { background: linear-gradient(#0072b222, #0072b222), Canvas; }
";

/// Sorts a table by the column whose head is pressed; again: the other way round; what was not measured stays last.
const SCRIPT: &str = "
for (const button of document.querySelectorAll('th button')) button.addEventListener('click', () => {
  const head = button.parentElement, body = head.closest('table').tBodies[0], column = head.cellIndex;
  const up = head.getAttribute('aria-sort') !== 'ascending';
  for (const other of head.parentElement.cells) other.removeAttribute('aria-sort');
  head.setAttribute('aria-sort', up ? 'ascending' : 'descending');
  const key = row => { const cell = row.cells[column], value = cell.dataset.value;
    return value === undefined ? cell.textContent : value === '' ? null : Number(value); };
  const order = (a, b) => a === null || b === null ? (a === null) - (b === null)
    : (typeof a === 'number' && typeof b === 'number' ? a - b : String(a).localeCompare(String(b), 'en', {numeric: true}))
      * (up ? 1 : -1);
  body.append(...[...body.rows].sort((a, b) => order(key(a), key(b))));
});
";

impl Page {
    /// With a heading and nothing else.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), body: String::new() }
    }

    /// With one more heading.
    pub fn heading(mut self, text: &str) -> Self {
        self.body += &format!("<h2>{}</h2>\n", escaped(text));
        self
    }

    /// With one more paragraph of plain text.
    pub fn paragraph(mut self, text: &str) -> Self {
        self.body += &format!("<p>{}</p>\n", escaped(text));
        self
    }

    /// With a plot, laid out twice: as it is, and for screens as narrow as a phone's.
    ///
    /// # Errors
    /// Those of [`Plot::to_svg`].
    pub fn plot(mut self, plot: &Plot) -> Result<Self, Error> {
        let narrow = plot.narrow();
        for (class, plot) in [("roomy", plot), ("narrow", &narrow)] {
            // Several plots share the page's namespace of ids.
            let id = format!("frame{}", self.body.len());
            let svg = plot
                .to_svg()?
                .replace("id=\"frame\"", &format!("id=\"{id}\""))
                .replace("url(#frame)", &format!("url(#{id})"));
            self.body += &format!("<figure class=\"{class}\">{svg}</figure>\n");
        }
        Ok(self)
    }

    /// With a table whose columns sort when their head is pressed.
    pub fn table(mut self, table: &Table) -> Self {
        self.body += &table.to_html();
        self
    }

    /// With a picture: the bytes of a PNG file, and what it shows for those who cannot see it.
    pub fn png(mut self, png: &[u8], what_it_shows: &str) -> Self {
        let data = base64::engine::general_purpose::STANDARD.encode(png);
        let alt = escaped(what_it_shows);
        self.body += &format!("<figure><img alt=\"{alt}\" src=\"data:image/png;base64,{data}\"></figure>\n");
        self
    }

    /// The whole file.
    pub fn to_html(&self) -> String {
        let title = escaped(&self.title);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src \
             'unsafe-inline'; script-src 'unsafe-inline'\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title><style>{STYLE}</style></head>\n<body><h1>{title}</h1>\n{}<script>{SCRIPT}</script>\
             </body></html>\n",
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Axis, Cell, Column};

    #[test]
    fn a_page_stands_alone() {
        let mut table = Table::new(vec![Column::new("a", 1)]);
        table.push(vec![Cell::Number(1.0)], true);
        let plot = Plot::new("p", Axis::linear("x"), Axis::linear("y"));
        let page = Page::new("<T>").heading("h").paragraph("a < b").table(&table).png(b"\x89PNG", "nothing");
        let page = page.plot(&plot).unwrap().plot(&plot).unwrap().to_html();
        assert!(
            page.contains("<title>&lt;T&gt;</title>")
                && page.contains("a &lt; b")
                && page.contains("iVBORw==")
        );
        for reference in ["src=\"http", "href=", "@import", "url(http"] {
            assert!(!page.contains(reference), "{reference}");
        }
        let mut ids: Vec<&str> =
            page.split("id=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        let all = ids.len();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!((all, ids.len()), (4, 4));
        assert_eq!(
            (page.matches("viewBox=\"0 0 760").count(), page.matches("viewBox=\"0 0 360").count()),
            (2, 2)
        );
    }
}
