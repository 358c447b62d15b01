"""Measurement of the boxes of all texts on a page."""

from playwright.sync_api import Page

FIND_FAULTS = """() => {
    const shown = (element) => element.checkVisibility({ checkOpacity: true, checkVisibilityCSS: true })
        && !element.closest(".unseen, .labels3d, option");
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    const lines = [];
    while (walker.nextNode()) {
        const node = walker.currentNode;
        if (!node.data.trim() || !shown(node.parentElement)) continue;
        const range = document.createRange();
        range.selectNodeContents(node);
        for (const box of range.getClientRects()) {
            if (box.width > 1 && box.height > 1) lines.push({ node, box, text: node.data.trim() });
        }
    }
    const found = [];
    for (const { node, box, text } of lines) {
        if (box.left < -1 || box.right > innerWidth + 1) found.push(`outside the page: ${text}`);
        for (let at = node.parentElement; at !== null; at = at.parentElement) {
            const style = getComputedStyle(at);
            if (style.overflowX !== "hidden" && style.overflowX !== "clip") continue;
            const limit = at.getBoundingClientRect();
            if (box.right > limit.right + 2 || box.left < limit.left - 2 || box.bottom > limit.bottom + 4) {
                found.push(`cut off: ${text}`);
            }
        }
    }
    // Line boxes are higher than the letters, so some pixels of two lines may coincide.
    lines.forEach((one, index) => {
        for (const two of lines.slice(index + 1)) {
            if (one.node === two.node) continue;
            const width = Math.min(one.box.right, two.box.right) - Math.max(one.box.left, two.box.left);
            const height = Math.min(one.box.bottom, two.box.bottom) - Math.max(one.box.top, two.box.top);
            if (width > 2 && height > 5) found.push(`on top of each other: ${one.text} | ${two.text}`);
        }
    });
    return [...new Set(found)];
}"""


def assert_texts_fit(page: Page) -> None:
    """Assert that no text is cut off, outside the page, or drawn over another one. The page must be at its top."""
    page.evaluate("() => scrollTo(0, 0)")
    faults = page.evaluate(FIND_FAULTS)
    assert not faults, "\n".join(faults)
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
