import { useState } from "preact/hooks";
import { signIn } from "./state/session";
import { refreshNow } from "./state/updates";
import { rich, t } from "./texts/translate";
import { Failed, useAction } from "./ui/action";
import { ManualLink, SECTIONS } from "./ui/manual";

const COMMAND = "pointchain token add";

/** Ask for the token once; afterwards a cookie holds it. */
export function Login() {
  const [token, setToken] = useState("");
  const action = useAction();
  return (
    <main id="main" class="login">
      <h1>{t("login.title")}</h1>
      <p>{rich("login.intro", { command: COMMAND, code: (content) => <code>{content}</code> })}</p>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void action.run(async () => {
            await signIn(token);
            refreshNow();
          });
        }}
      >
        <label>
          {t("login.token")}
          <input
            type="password"
            autocomplete="current-password"
            value={token}
            onInput={(event) => setToken(event.currentTarget.value)}
            required
          />
        </label>
        <button class="main" disabled={action.busy}>
          {t("login.button")}
        </button>
      </form>
      <Failed failure={action.failure && { ...action.failure, title: t("login.failed") }} />
      <p>
        <ManualLink page={SECTIONS["sign-in"]} name={t("login.help")}>
          {t("login.help")}
        </ManualLink>
      </p>
    </main>
  );
}
