// Prints as JSON which texts are not in the catalogue, and which keys of the catalogue no source uses.
//
// A text for people is: a JSX text with a letter; a literal with a letter as a child of an element or in an attribute
// of TEXT_ATTRIBUTES; any other literal with two words or a capitalised word. Excluded are module names, compared
// values, messages of errors, style classes, selectors, shaders, header names, keys and the literals of NO_TEXT.
import { readdir, readFile } from "node:fs/promises";
import { join } from "node:path";
import ts from "typescript";
import { entriesOf } from "./texts.mjs";

const TEXT_ATTRIBUTES = new Set(["alt", "aria-label", "doing", "empty", "label", "name", "placeholder", "title"]);
/** Properties that name style classes or fonts. */
const STYLES = new Set(["class", "className", "kind", "font", "background"]);
const NO_TEXT = new Set([
  "pointchain token add", // a command
  "pointchain token code NAME", // a command
  "mode", // the group of radio buttons
]);
const KEYS = /^(Arrow(Left|Right|Up|Down)|Escape|Enter)$/;
const HEADERS = /^([A-Z][a-z]*-)+([A-Z]|ID)[A-Za-z]*$|^Accept$/;
const LETTER = /[A-Za-z]/;
const PROSE = /[A-Za-z]{2,}[,.:;]? [A-Za-z]{2,}|^\s*[A-Z][a-z]+/;

const { SyntaxKind: Kind } = ts;

/** Return the fixed parts of a string or template literal; null for other nodes. */
function partsOf(node) {
  if (ts.isStringLiteral(node) || ts.isNoSubstitutionTemplateLiteral(node)) return [node.text];
  if (ts.isTemplateExpression(node)) return [node.head.text, ...node.templateSpans.map((span) => span.literal.text)];
  return null;
}

function ancestor(node, matches) {
  for (let at = node.parent; at !== undefined; at = at.parent) if (matches(at)) return at;
  return undefined;
}

function isExcluded(node) {
  const { parent } = node;
  if (/^\s*(uniform|varying) |^linear-gradient\(/.test(node.text ?? node.head.text)) return true;
  if (ts.isBinaryExpression(parent) && /^[=!]==$/.test(parent.operatorToken.getText())) return true;
  if (ts.isCallExpression(parent) && /(^super|matches|matchMedia|querySelector(All)?(<\w+>)?)$/.test(parent.expression.getText())) return true;
  if (ts.isImportDeclaration(parent) || ts.isExportDeclaration(parent) || ts.isLiteralTypeNode(parent)) return true;
  if (ts.isElementAccessExpression(parent) || (parent.kind === Kind.CallExpression && parent.expression.kind === Kind.ImportKeyword)) return true;
  if (ts.isPropertyAssignment(parent) && parent.name === node) return KEYS.test(node.text) || HEADERS.test(node.text);
  if (ancestor(node, (at) => ts.isNewExpression(at) && /Error$/.test(at.expression.getText()))) return true;
  if (ancestor(node, (at) => ts.isJsxAttribute(at) && STYLES.has(at.name.getText()))) return true;
  if (ancestor(node, (at) => ts.isPropertyAssignment(at) && STYLES.has(at.name.getText()))) return true;
  return ts.isBinaryExpression(parent) && /\.(className|font)$/.test(parent.left.getText());
}

function isText(node, parts) {
  const attribute = ts.isJsxAttribute(node.parent) ? node.parent : undefined;
  const holder = ancestor(node, (at) => ts.isJsxExpression(at) || ts.isCallExpression(at) || ts.isJsxAttribute(at));
  const shown = attribute ?? (holder && ts.isJsxExpression(holder) ? holder.parent : undefined);
  if (shown && ts.isJsxAttribute(shown) && TEXT_ATTRIBUTES.has(shown.name.getText())) return LETTER.test(parts.join(""));
  if (shown && ts.isJsxElement(shown)) return LETTER.test(parts.join(""));
  return parts.some((part) => PROSE.test(part));
}

const texts = [];
const used = [];

function visit(node, file) {
  const report = (text) => {
    const { line } = file.getLineAndCharacterOfPosition(node.getStart());
    texts.push(`${file.fileName}:${line + 1}: ${text.trim()}`);
  };
  if (ts.isJsxText(node) && LETTER.test(node.text)) report(node.text);
  const parts = partsOf(node);
  if (parts !== null) {
    used.push(parts);
    const plain = parts.length === 1 ? parts[0] : null;
    const known = plain !== null && (NO_TEXT.has(plain) || KEYS.test(plain) || HEADERS.test(plain));
    if (!known && !isExcluded(node) && isText(node, parts)) report(parts.join("{}"));
  }
  ts.forEachChild(node, (child) => visit(child, file));
}

for (const name of (await readdir("src", { recursive: true })).sort()) {
  if (!/\.tsx?$/.test(name)) continue;
  const path = join("src", name);
  const kind = name.endsWith("x") ? ts.ScriptKind.TSX : ts.ScriptKind.TS;
  const file = ts.createSourceFile(path, await readFile(path, "utf8"), ts.ScriptTarget.Latest, true, kind);
  visit(file, file);
}

const page = await readFile("index.html", "utf8");
used.push(...[...page.matchAll(/data-(?:text|title)="([^"]+)"/g)].map(([, key]) => [key]));

const escape = (text) => text.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
const patterns = used
  .filter((parts) => parts[0].includes("."))
  .map((parts) => new RegExp(`^${parts.map(escape).join("[\\w-]+(?:\\.[\\w-]+)?")}$`));
// `hint.${term}` and the like begin with the dot in their first part, so they are among these patterns.
const catalogue = JSON.parse(await readFile("src/texts/en.json", "utf8"));
const unused = entriesOf(catalogue)
  .map(([key]) => key)
  .filter((key) => !patterns.some((pattern) => pattern.test(key)));

console.log(JSON.stringify({ texts, unused }));
