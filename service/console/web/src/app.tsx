import { Fault } from "./bar/fault";
import { Stopped } from "./bar/stopped";
import { Login } from "./login";
import { addressOf, go, route, SCREENS } from "./route";
import { LoadedScreen } from "./screens";
import { caller, signOut } from "./state/session";
import { findText, t } from "./texts/translate";
import { useAction } from "./ui/action";
import { LanguageChoice } from "./ui/language_choice";
import { ManualLink, SECTIONS } from "./ui/manual";
import { narrow } from "./ui/narrow";

/** Everything below the bar. */
export function App() {
  if (caller.value === undefined) return <main id="main">{t("app.waiting")}</main>;
  const { screen, id, signInCode } = route.value;
  if (caller.value === null || signInCode !== null) return <Login />;
  return (
    <>
      <nav aria-label={t("app.screens")}>
        {SCREENS.map((one, k) => (
          <a key={one} href={addressOf(one)} aria-current={one === screen ? "page" : undefined}>
            <kbd aria-hidden="true">{k + 1}</kbd> {t(`app.screen.${one}`)}
          </a>
        ))}
        <ManualLink page={SECTIONS[screen]} name={t("help.page")}>
          {t("help.link")}
        </ManualLink>
        {!narrow.value && <CallerInfo />}
      </nav>
      <Fault />
      <Stopped open={screen === "scan"} />
      <main id="main" tabIndex={-1}>
        <LoadedScreen key={`${screen}/${id}`} screen={screen} id={id} />
      </main>
      {narrow.value && (
        <footer>
          <CallerInfo />
        </footer>
      )}
    </>
  );
}

function CallerInfo() {
  const action = useAction();
  const { value } = caller;
  if (!value) return null;
  if (value.local) {
    return (
      <p class="who">
        {t("app.local")} <LanguageChoice />
      </p>
    );
  }
  return (
    <p class="who">
      {t("app.signed_in", { name: value.name, role: findText(`app.role.${value.role}`) ?? value.role })}{" "}
      <button type="button" class="plain" disabled={action.busy} onClick={() => void action.run(signOut)}>
        {t("app.sign_out")}
      </button>{" "}
      <LanguageChoice />
    </p>
  );
}

/** Change the screen by the keys 1 to 4, except while a person types. */
export function screenKeys(event: KeyboardEvent): void {
  const typing = event.target instanceof HTMLElement && event.target.matches("input, select, textarea");
  if (typing || event.ctrlKey || event.altKey || event.metaKey) return;
  const screen = SCREENS[Number(event.key) - 1];
  if (screen !== undefined) go(screen);
}
