/// `text` fit for XML and HTML, in elements and in quoted attributes; control characters, which XML forbids, become
/// the replacement character.
pub(crate) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(c),
            c if c.is_control() || c == '\u{fffe}' || c == '\u{ffff}' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// About how wide `text` is in a sans-serif font of `size_px`: a little too wide rather than too narrow, because the
/// reader's font is not known here.
pub(crate) fn width_px(text: &str, size_px: f64) -> f64 {
    let em = |c: char| match c {
        'i' | 'j' | 'l' | '.' | ',' | ':' | ';' | '\'' | '|' | '!' => 0.30,
        ' ' | 'f' | 't' | 'r' | 'I' | '(' | ')' | '[' | ']' | '-' | '/' => 0.40,
        'm' | 'w' | 'M' | 'W' | '%' | '@' => 0.95,
        c if c.is_ascii_uppercase() => 0.72,
        c if c.is_ascii() => 0.58,
        _ => 1.0,
    };
    size_px * text.chars().map(em).sum::<f64>()
}

/// A number for a person: `decimals` places, or in powers of ten where that would show nothing or too much.
pub(crate) fn number(value: f64, decimals: usize) -> String {
    let digits = value.abs();
    if value == 0.0 {
        "0".to_owned()
    } else if !value.is_finite() {
        if value.is_nan() {
            "not a number".to_owned()
        } else if value > 0.0 {
            "∞".to_owned()
        } else {
            "−∞".to_owned()
        }
    } else if digits >= 1e7 || digits < 0.5 * 10f64.powi(-(decimals.min(300) as i32)) {
        format!("{value:.2e}")
    } else {
        format!("{value:.decimals$}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_breaks_out_of_markup() {
        assert_eq!(escaped("<a href='x'>&\"\u{1}"), "&lt;a href=&#39;x&#39;&gt;&amp;&quot;\u{fffd}");
    }

    #[test]
    fn numbers_show_something() {
        assert_eq!(number(1.0 / 3.0, 3), "0.333");
        assert_eq!(number(1e-9, 3), "1.00e-9");
        assert_eq!(number(3e12, 3), "3.00e12");
        assert_eq!(number(0.0, 3), "0");
        assert_eq!(number(f64::NAN, 3), "not a number");
    }
}
