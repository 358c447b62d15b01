import { useEffect, useState } from "preact/hooks";
import { leaveSignIn, removeSignInCode, route } from "./route";
import { caller, isToken, signIn } from "./state/session";
import { refreshNow } from "./state/updates";
import { rich, t } from "./texts/translate";
import { Failed, useAction } from "./ui/action";
import { LanguageChoice } from "./ui/language_choice";
import { ManualLink, SECTIONS } from "./ui/manual";

const CODE_COMMAND = "pointchain token code NAME";
const TOKEN_COMMAND = "pointchain token add";

/**
 * Ask for a code or a token once; afterwards a cookie identifies the caller.
 *
 * A code in the address fills the field. Only a person sends it, because a code is valid once and programs open links
 * to show a preview.
 */
export function Login() {
  const code = route.value.signInCode ?? "";
  const [text, setText] = useState(code);
  const action = useAction();
  useEffect(() => {
    if (code !== "") setText(code);
  }, [code]);
  return (
    <main id="main" class="login">
      <h1>{t("login.title")}</h1>
      {code === "" ? <Intro /> : <p>{t("login.from_address")}</p>}
      <form
        onSubmit={(event) => {
          event.preventDefault();
          removeSignInCode();
          void action.run(async () => {
            await signIn(text);
            leaveSignIn();
            refreshNow();
          });
        }}
      >
        <label>
          {t("login.field")}
          <input
            type="text"
            class={isToken(text) ? "secret" : undefined}
            autocomplete="one-time-code"
            autocapitalize="off"
            autocorrect="off"
            spellcheck={false}
            value={text}
            onInput={(event) => setText(event.currentTarget.value)}
            required
          />
        </label>
        <button class="main" disabled={action.busy}>
          {t("login.button")}
        </button>
      </form>
      <SignedIn />
      <Failed failure={action.failure && { ...action.failure, title: t("login.failed") }} />
      <p>
        <ManualLink page={SECTIONS["sign-in"]} name={t("login.help")}>
          {t("login.help")}
        </ManualLink>
      </p>
      <LanguageChoice />
    </main>
  );
}

function Intro() {
  const commands = { code_command: CODE_COMMAND, token_command: TOKEN_COMMAND };
  return <p>{rich("login.intro", { ...commands, code: (content) => <code>{content}</code> })}</p>;
}

/** Who is signed in, if a person opened the address of a code. */
function SignedIn() {
  const { value } = caller;
  if (!value) return null;
  return (
    <p>
      {t("login.signed_in", { name: value.name })}{" "}
      <button type="button" class="plain" onClick={leaveSignIn}>
        {t("login.stay", { name: value.name })}
      </button>
    </p>
  );
}
